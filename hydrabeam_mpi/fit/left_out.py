"""Rows that a result left out of its own data, such as bad integrations and outliers: which they are, once more.

Changes of the weights speak of the antennas, baselines and times that the result had. Antennas that a loop put aside,
which other users of the data may have again, are none of these.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hydrabeam_mpi.data.observation import Array, BoolArray, IntArray
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.registry import REWEIGHTINGS, make_reweighting
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.state import Fitted, Reweighted
from hydrabeam_mpi.io.inferred import Inferred


@dataclass(frozen=True)
class LeftOut:
    """Changes of the weights of a result.

    Attributes
    ----------
    changes : tuple of Reweighted
        Of all the result's channels, in the order in which they apply.
    setup : ObservingSetup
        What was known of the data, with the result's baselines.
    place : ndarray of int, (Nbls,)
        Which of these each baseline of the data is; -1 for others.
    """

    changes: tuple[Reweighted, ...]
    setup: ObservingSetup
    place: IntArray

    @property
    def titles(self) -> dict[str, str]:
        """Those that leave out rows: titles by kind."""
        return {one.change.kind: one.change.title for one in self.changes if one.change.leaves_out}


def leaves_out(result: Inferred) -> bool:
    """Whether changes of the weights are part of a result that leave out rows."""
    kinds = {str(entry.get("kind")) for entry in result.entries}
    return any(change.leaves_out for kind, change in REWEIGHTINGS.items() if kind in kinds)


def restore_changes(result: Inferred, setup: ObservingSetup) -> LeftOut | None:
    """Return the changes of the weights of a result in its own data; None where these are not all of its times. Serial.

    Parameters
    ----------
    result : Inferred
        Which `leaves_out` rows.
    setup : ObservingSetup
        Of its own data.
    """
    known, place = _as_observed(setup, result.content.observed)
    changes = []
    for entry in result.entries:
        if entry["kind"] in REWEIGHTINGS:
            change = make_reweighting(entry["kind"], entry["settings"])
            x, std = (np.array(entry[key]) for key in ("values", "std"))
            if x.shape[1] not in change.sizes(known):
                return None
            changes.append(Reweighted(change, x, std))
    return LeftOut(tuple(changes), known, place)


def are_left_out(context: FitContext, fitted: Fitted, left: LeftOut) -> BoolArray:
    """Return which of a rank's rows that count are left out, (Nlocal, Ntimes, Nbls). Serial."""
    at, data = fitted.estimate, context.test
    rows, added = data.calibrated(at)
    lost = np.zeros(rows.data.shape, dtype=bool)
    here = left.place[rows.tile.bls]
    known = np.flatnonzero(here >= 0)
    for channel, number in enumerate(context.channels):
        for span, block, _ in data.row_blocks(channel, at, added[channel], rows):
            weights = block.weights[:, known]
            there = replace(
                block,
                setup=left.setup,
                bls=here[known],
                member=block.member[known],
                weights=weights,
                residual=block.residual[:, known],
                vis=block.vis[:, known],
            )
            for one in left.changes:
                # One after the other: a threshold is about weights that the others have changed already.
                factor = one.change.weight_factor(there, one.x[number])
                there = replace(there, weights=there.weights * factor)
            lost[channel, span][:, known] = (weights > 0) & (there.weights == 0)
    return lost


def _as_observed(setup: ObservingSetup, observed: dict[str, Array]) -> tuple[ObservingSetup, IntArray]:
    """Return what was known of the baselines that a result says that it had, and which of them these are, (Nbls,)."""
    observation, n_bls = setup.observation, setup.observation.Nbls
    if "baselines" not in observed:  # of an earlier version
        return setup, np.arange(n_bls)
    numbers, antpairs = observed["antenna_numbers"], observed["baselines"]
    known: dict[Any, int] = {frozenset(pair): place for place, pair in enumerate(antpairs.tolist())}
    place = np.array([known.get(frozenset(pair), -1) for pair in observation.antpairs.tolist()], dtype=int)
    there = replace(
        observation,
        antenna_numbers=numbers,
        antenna_names=tuple(map(str, numbers.tolist())),
        antpos=observed["antenna_positions"],
        antpairs=antpairs,
    )
    nothing = np.zeros(len(antpairs), dtype=int)
    redundant = replace(setup.redundant, group=nothing, flipped=nothing.astype(bool))
    return replace(setup, observation=there, redundant=redundant), place
