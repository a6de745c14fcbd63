"""Whitened residuals, regrouped so that a rank has all channels and times of its baselines, in whole redundant groups.

Ranks share out times and channels; fringe rates, delays and correlations between neighbours need all of a baseline's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hydrabeam_mpi.data.observation import BoolArray, ComplexArray, FloatArray, IntArray, Observation
from hydrabeam_mpi.data.partition import split_by_cost
from hydrabeam_mpi.data.redundancy import RedundantGroups
from hydrabeam_mpi.loop.residuals.spectra import Spectrum
from hydrabeam_mpi.mpi import Comm, allreduce_max

MAX_BYTES = 2**26  # of what a rank sends at once


@dataclass(frozen=True)
class Layout:
    """All the rows that residuals may have, the same on every rank.

    Attributes
    ----------
    observation : Observation
        Of all channels.
    redundant : RedundantGroups
        Of the observation's baselines.
    times : ndarray of int, (Nt,)
        The observation's times that have residuals, ascending.
    """

    observation: Observation
    redundant: RedundantGroups
    times: IntArray

    @property
    def shape(self) -> tuple[int, int, int]:
        """(Nfreqs, Nt, Nbls)."""
        return self.observation.Nfreqs, len(self.times), self.observation.Nbls

    @cached_property
    def fringe_rates(self) -> Spectrum:
        """The transform over times, in Hz."""
        return Spectrum.of(self.observation.times[self.times] * 86400.0)

    @cached_property
    def delays(self) -> Spectrum:
        """The transform over channels, in seconds."""
        return Spectrum.of(self.observation.freqs, whole=True)

    def shares(self, n_ranks: int) -> list[IntArray]:
        """Return the baselines of each rank, (Nown,): whole redundant groups."""
        group = self.redundant.group
        parts = split_by_cost(np.bincount(group).astype(float), n_ranks)
        return [np.flatnonzero((group >= part.start) & (group < part.stop)) for part in parts]


@dataclass(frozen=True)
class Residuals:
    """A rank's whitened residuals: real and imaginary parts are N(0, 1) if the model is right.

    Attributes
    ----------
    z : ndarray of complex, (Nfreqs_local, Ntimes_local, Nbls_local)
        In the sense of the redundant groups.
    used : ndarray of bool, same shape
        Which count. Every row of the layout is used on one rank at most.
    channels, times, bls : ndarray of int
        Indices into the layout's observation.
    """

    z: ComplexArray
    used: BoolArray
    channels: IntArray
    times: IntArray
    bls: IntArray

    def divided(self, antenna_scales: FloatArray, layout: Layout) -> Residuals:
        """Divide by the scales of both antennas: variances s_i s_j for ``antenna_scales`` s, (Nants,)."""
        one, two = layout.observation.antenna_index[self.bls].T
        return replace(self, z=self.z / np.sqrt(antenna_scales[one] * antenna_scales[two]))


@dataclass(frozen=True)
class Cube:
    """All residuals of some baselines.

    Attributes
    ----------
    z : ndarray of complex64, (Nfreqs, Nt, Nown)
        NaN where there are none.
    bls : ndarray of int, (Nown,)
        Indices into the layout's baselines.
    layout : Layout
    """

    z: NDArray[np.complex64]
    bls: IntArray
    layout: Layout

    def channel(self, index: int) -> tuple[ComplexArray, BoolArray]:
        """Return the residuals of a channel, zero where there are none, and which there are; both (Nt, Nown)."""
        used = ~np.isnan(self.z[index].real)
        return np.where(used, self.z[index], 0).astype(complex), used


def whole_baselines(comm: Comm, residuals: Residuals, layout: Layout, max_bytes: int = MAX_BYTES) -> Cube:
    """Give every rank all residuals of its share of the baselines. Collective: all ranks of `comm`.

    All ranks together hold the residuals once more, in single precision.

    Parameters
    ----------
    comm : Comm
    residuals : Residuals
        This rank's; rows may be empty.
    layout : Layout
    max_bytes : int
        About what a rank sends at once.
    """
    shares = layout.shares(comm.size)
    owner, place = np.empty((2, layout.observation.Nbls), dtype=int)
    for rank, bls in enumerate(shares):
        owner[bls], place[bls] = rank, np.arange(len(bls))
    marked = np.where(residuals.used, residuals.z, np.nan).astype(np.complex64)
    time_places = np.searchsorted(layout.times, residuals.times)

    n_rounds = np.array([max(1, -(-marked.nbytes // max_bytes))])
    allreduce_max(comm, n_rounds)
    z = np.full((*layout.shape[:2], len(shares[comm.rank])), np.nan, np.complex64)
    for part in np.array_split(np.arange(len(residuals.bls)), int(n_rounds[0])):
        owners = owner[residuals.bls[part]]
        chosen = [part[owners == rank] for rank in range(comm.size)]
        pieces = [(residuals.channels, time_places, place[residuals.bls[mine]], marked[..., mine]) for mine in chosen]
        for channels, times, places, values in comm.alltoall(pieces):
            z[np.ix_(channels, times, places)] = values
    return Cube(z, shares[comm.rank], layout)
