"""Chains of draws: those that `hydrabeam sample` wrote, or writes."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hydrabeam_mpi.data.observation import Array
from hydrabeam_mpi.sampling.storage.store import ChainStore

if TYPE_CHECKING:
    from collections.abc import Iterable

    import xarray as xr

    from hydrabeam_mpi.sampling.heldout import HeldOut
    from hydrabeam_mpi.sampling.status import Status


class Chains:
    """A folder of chains, which may still grow: every call looks at what is whole by then.

    Parameters
    ----------
    folder : Path

    Raises
    ------
    InputError
        If it has no chains.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._store = ChainStore.open(folder)

    @property
    def names(self) -> list[str]:
        """What is drawn."""
        return [variable.name for variable in self._store.variables]

    def read(self, name: str) -> Array:
        """Return the draws of a variable after the warm-up, (n_chains, n_draws, and its axes).

        Chains are cut to a common length; those that are less than half as long as the longest are left out.

        Raises
        ------
        InputError
            If there is no such variable.
        """
        chains, draws = self._store.comparable()
        shape = self._store.variable(name).shape
        drawn = [self._store.read(name, chain, draws) for chain in chains]
        return np.stack(drawn) if drawn else np.empty((0, 0, *shape))

    def to_arviz(self, names: Iterable[str] | None = None) -> xr.DataTree:
        """Return all draws, or those of some variables, as ArviZ takes them: ``posterior`` and ``sample_stats``.

        ``.to_netcdf(path)`` of what comes back writes them to a file.

        Raises
        ------
        InputError
            If there is no such variable.
        """
        from hydrabeam_mpi.sampling.arviz import to_datatree

        return to_datatree(self._store, names)

    def status(self) -> Status:
        """Return how far the chains are, seconds a draw and the time that is left; ``print(chains.status())``."""
        from hydrabeam_mpi.sampling.status import status_of

        return status_of(self._store)

    def summary(self) -> dict[str, dict[str, Any]]:
        """Return of each block the worst R-hat and whose it is, the smallest ESS, and ESS a second."""
        from hydrabeam_mpi.sampling.convergence import diagnose

        return {one.block: asdict(one) for one in diagnose(self._store).blocks}

    def held_out(self) -> HeldOut | None:
        """Return how well the draws predict held-out rows, such as ``chains.held_out().chi2``; None if there are none.

        Of each draw it stands in ``chains.to_arviz()["sample_stats"]``.
        """
        from hydrabeam_mpi.sampling.heldout import heldout_of

        return heldout_of(self._store)


def load_chains(folder: str | Path) -> Chains:
    """Read a folder of chains, which `hydrabeam sample` wrote or is writing.

    Raises
    ------
    InputError
        If it has no chains.
    """
    return Chains(Path(folder))
