"""Whitened residuals of a small array, with structures planted in them."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from hydrabeam_mpi.config.simulation import Array, Simulate
from hydrabeam_mpi.data.partition import make_tiles
from hydrabeam_mpi.data.redundancy import find_redundant_groups
from hydrabeam_mpi.loop.residuals.cube import Layout, Residuals, whole_baselines
from hydrabeam_mpi.loop.residuals.sums import ResidualSums
from hydrabeam_mpi.random import complex_normal, generator
from hydrabeam_mpi.simulation.mock import mock_observation


def make_layout(
    n_freqs: int = 6,
    n_times: int = 60,
    every: int = 3,
    hexagon: tuple[int, int] = (2, 3),
    lst_range: tuple[float, float] = (3.0, 8.0),
) -> Layout:
    """Seven antennas with 21 baselines in 9 redundant groups, 20 held-out times, six channels."""
    freqs = tuple(131e6 + 0.5e6 * np.arange(n_freqs))
    settings = Simulate(array=Array(hex=hexagon), n_times=n_times, freqs=freqs, lst_range=lst_range)
    observation = mock_observation(settings, "ee")
    return Layout(observation, find_redundant_groups(observation.bl_vectors, 1e-3), np.arange(1, n_times, every))


def noise(layout: Layout, seed: int = 0) -> np.ndarray:
    """Real and imaginary parts N(0, 1), (Nfreqs, Nt, Nbls)."""
    return np.sqrt(2) * complex_normal(generator(seed, "whitened"), layout.shape)


def sums_of(layout: Layout, z: np.ndarray, used: np.ndarray | None = None) -> ResidualSums:
    return ResidualSums.of(whole_baselines(MPI.COMM_SELF, everything(layout, z, used), layout))


def everything(layout: Layout, z: np.ndarray, used: np.ndarray | None = None) -> Residuals:
    """All rows on one rank."""
    used = np.ones(z.shape, dtype=bool) if used is None else used
    return Residuals(z, used, np.arange(layout.shape[0]), layout.times, np.arange(layout.shape[2]))


def share_of(comm: MPI.Comm, layout: Layout, z: np.ndarray, used: np.ndarray, n_groups: int) -> Residuals:
    """A rank's rows, channels among groups of ranks and then rows within a group, as a run shares them out."""
    n_groups = min(n_groups, comm.size)
    sizes = [len(part) for part in np.array_split(np.arange(comm.size), n_groups)]
    index = int(np.searchsorted(np.cumsum(sizes), comm.rank, side="right"))
    rank = comm.rank - sum(sizes[:index])
    channels = np.array_split(np.arange(layout.shape[0]), n_groups)[index]
    bls, group = np.arange(layout.shape[2]), layout.redundant.group
    tile = make_tiles(layout.times, np.ones(len(layout.times)), bls, group, sizes[index])[rank]
    mine = np.ix_(channels, np.searchsorted(layout.times, tile.times), tile.bls)
    return Residuals(z[mine], used[mine], channels, tile.times, tile.bls)
