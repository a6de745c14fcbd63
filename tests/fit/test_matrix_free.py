"""Conjugate gradients over rank groups, against the same system as one matrix."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.fit import matrix_free
from hydrabeam_mpi.fit.matrix_free import solve_matrix_free
from hydrabeam_mpi.inference.coupled import ChannelTold, CoupledEquations
from hydrabeam_mpi.inference.over_frequency import legendre, modes_of, squared_exponential
from hydrabeam_mpi.mpi import ProcessGrid
from hydrabeam_mpi.random import complex_normal, generator

pytestmark = pytest.mark.mpi
FREQS: FloatArray = np.array([120.0, 121.0, 121.5, 124.0, 128.0, 131.0]) * 1e6
N, N_DRAWS = 6, 16


def told_of(channel: int, is_complex: bool) -> ChannelTold:
    """Return what data say of a channel: of some combinations a hundred times more than of others."""
    rng = generator(1, "channel", channel)
    shape = (40, N)
    design = complex_normal(rng, shape) if is_complex else rng.standard_normal(shape)
    design = design * np.geomspace(100, 0.1, N) * (1 + 0.3 * channel)
    return ChannelTold(design.conj().T @ design, design.conj().T @ rng.standard_normal(40))


@pytest.mark.parametrize("is_complex", [False, True])
@pytest.mark.parametrize("modes", [modes_of(squared_exponential(FREQS, 5e6)), legendre(FREQS, 2)])
def test_is_the_answer_of_one_matrix(comm: MPI.Comm, modes: FloatArray, is_complex: bool) -> None:
    grid = ProcessGrid.split(comm, len(FREQS))
    every = [told_of(channel, is_complex) for channel in range(len(FREQS))]
    keys = [[("draw", channel, draw) for draw in range(N_DRAWS)] for channel in range(len(FREQS))]
    noise = [one.noise(key, 7, len(FREQS)) for one, key in zip(every, keys, strict=True)]
    equations = CoupledEquations(modes, N, is_complex, N_DRAWS)
    for channel, one in enumerate(every):
        equations.add(channel, one, noise[channel])
    expected = list(equations.solve().moments(7, range(N_DRAWS)))

    mine = grid.channels if grid.is_group_root else range(0)
    found, told = solve_matrix_free(grid, 7, modes, [every[f] for f in mine], [noise[f] for f in mine])
    assert told["n_unknowns"] == modes.shape[1] * N
    assert 0 < told["steps"] < 60
    assert len(found) == len(mine)
    for f, one in zip(mine, found, strict=True):
        std = np.sqrt(np.diag(expected[f].covariance).real)
        assert np.max(np.abs(one.mean - expected[f].mean) / std) < 1e-8
        assert np.max(np.abs(one.draws - expected[f].draws) / std) < 1e-8
        # An estimate, as is said: with channels that tell four times as much as others.
        assert np.all(np.abs(np.log(np.diag(one.covariance).real / std**2)) < np.log(2.5))


def test_what_does_not_come_to_an_end_is_refused_by_all(comm: MPI.Comm, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(matrix_free, "MAX_STEPS", 1)
    grid = ProcessGrid.split(comm, len(FREQS))
    mine = [told_of(channel, False) for channel in grid.channels if grid.is_group_root]
    noise = [one.noise([("draw", 0)], 0, len(FREQS)) for one in mine]
    with pytest.raises(InputError, match="conjugate gradients have not come to an end"):
        solve_matrix_free(grid, 0, modes_of(squared_exponential(FREQS, 5e6)), mine, noise)
