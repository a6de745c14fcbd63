"""Draws of all chains together, at even intervals, so that no more are in memory than a figure shows."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hydrabeam_mpi.config.sample import BEAM
from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.model.bases import basis_from_description
from hydrabeam_mpi.model.bases.base import LinearBasis
from hydrabeam_mpi.sampling.storage.store import ChainStore
from hydrabeam_mpi.sampling.storage.variable import Variable

MOST = 800
"""Draws of all chains together: standard deviations of as many have errors of 2.5%."""
AT_ONCE = 256
"""Draws that are read at a time."""


@dataclass(frozen=True, eq=False)
class Pooled:
    """Draws of the beam in one channel and of all else in it, one after the other by chain.

    Attributes
    ----------
    freq : float or None
        Of the channel, Hz.
    basis : LinearBasis
    beam : ndarray, (n_draws, n_modes)
    others : ndarray, (n_draws, n_others)
        All other numbers that move, of this channel or of all; of complex ones the real and the imaginary parts.
    labels : list of str
        Their names.
    """

    freq: float | None
    basis: LinearBasis
    beam: Array
    others: FloatArray
    labels: list[str]

    @property
    def n_draws(self) -> int:
        """How many there are."""
        return len(self.beam)

    @cached_property
    def standardised(self) -> FloatArray:
        """The others with mean 0 and variance 1, (n_draws, n_others)."""
        return standardised(self.others)


def standardised(values: FloatArray) -> FloatArray:
    """Give each column mean 0 and variance 1; to one that does not move, 0."""
    away = values - values.mean(axis=0)
    std = away.std(axis=0, ddof=1)
    return np.divide(away, std, out=np.zeros_like(away), where=std > 0)


def beam_of(store: ChainStore) -> Variable | None:
    """Return the variable that is the beam, if there is one."""
    return next((one for one in store.variables if one.block == BEAM and one.dims[-1:] == ("mode",)), None)


def pool(store: ChainStore, channel: int = 0) -> Pooled | None:
    """Read draws of a channel's beam and of all else in it; None where there is no beam, or no draw.

    Given what channels share, the numbers of others say nothing of this one's.

    Raises
    ------
    InputError
        If it is not known in which basis the beam is.
    """
    beam = beam_of(store)
    chains, draws = store.comparable()
    if beam is None or draws.stop - draws.start < 2:
        return None
    if "basis" not in store.about:
        raise InputError("does not say in which basis the beam is", file=store.folder, field="about basis")
    basis = basis_from_description(store.about["basis"])
    step = -(-len(chains) * (draws.stop - draws.start) // MOST)
    read = _read(store, beam, chains, draws, step, _of_channel(beam, channel))
    others, labels = [np.empty((len(read), 0))], []
    for variable in store.variables:
        if variable.block != BEAM:
            here = _of_channel(variable, channel)
            values = _read(store, variable, chains, draws, step, here)
            names = [variable.label(index) for index in range(here.start, here.stop)]
            parts = [(values, "")] if variable.dtype == "float64" else [(values.real, ""), (values.imag, "imaginary ")]
            for part, prefix in parts:
                moves = np.ptp(part, axis=0) > 0
                others.append(part[:, moves])
                labels += [prefix + name for name, keeps in zip(names, moves, strict=True) if keeps]
    freqs = beam.coords.get("freq", ())
    freq = float(freqs[channel]) if len(freqs) else None
    return Pooled(freq, basis, read, np.concatenate(others, axis=1), labels)


def _of_channel(variable: Variable, channel: int) -> slice:
    """Return the numbers of a variable that are of a channel, or all where they are of none alone."""
    if "freq" not in variable.dims:
        return slice(0, variable.size)
    assert variable.dims[0] == "freq", variable.name
    size = variable.size // variable.shape[0]
    return slice(channel * size, (channel + 1) * size)


def _read(
    store: ChainStore, variable: Variable, chains: tuple[int, ...], draws: slice, step: int, index: slice
) -> Array:
    """Read every ``step``-th draw of some numbers of a variable, (n, n_numbers)."""
    parts = []
    for chain in chains:
        for begin in range(draws.start, draws.stop, step * max(1, AT_ONCE // step)):
            end = min(begin + step * max(1, AT_ONCE // step), draws.stop)
            parts.append(store.read(variable.name, chain, slice(begin, end), index)[::step])
    return np.concatenate(parts)
