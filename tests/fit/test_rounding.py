"""Mixed precision: the mean is where double precision has it, or all is repeated in double."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from hydrabeam_mpi.api.preparation import prepare_shared_each
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.fit.channels import ChannelResult, infer_channels
from hydrabeam_mpi.fit.clock import Clock
from hydrabeam_mpi.fit.rounding import MOST_SHIFT, Rounding
from hydrabeam_mpi.fit.shares import read_share
from hydrabeam_mpi.mpi import ProcessGrid
from hydrabeam_mpi.setup.job_file import load
from hydrabeam_mpi.setup.problem import Problem
from tests.loop.mock import context_of, mock_job, write_job

REAL: dict[str, Any] = {"n_modes": 24, "k_max": 24, "m_max": 0}
COMPLEX: dict[str, Any] = {"n_modes": 30, "k_max": 20, "m_max": 2, "form": "complex", "boundary": "dirichlet"}


def problem_of(world: MPI.Comm, folder: Path, **changes: Any) -> Problem:
    if world.rank == 0:
        write_job(mock_job(**changes), folder)
    world.Barrier()
    (problem,) = prepare_shared_each(world, load(world, folder / "job.toml"), folder)
    return problem


def infer(world: MPI.Comm, problem: Problem, precision: str) -> list[ChannelResult]:
    job = problem.job.model_copy(update={"solver": problem.job.solver.model_copy(update={"precision": precision})})
    grid = ProcessGrid.split(world, problem.observation.Nfreqs)
    return infer_channels(grid, replace(problem, job=job).of_channels(grid.channels), Clock())


def moved(one: ChannelResult, other: ChannelResult) -> float:
    """Return by how much of its std the coefficient differs that differs most."""
    return float(np.max(np.abs(one.posterior.mean - other.posterior.mean) / other.posterior.std))


@pytest.mark.mpi
@pytest.mark.parametrize("basis", [REAL, COMPLEX], ids=["real", "complex"])
def test_the_mean_moves_no_more_than_expected(comm: MPI.Comm, common_tmp_path: Path, basis: dict[str, Any]) -> None:
    noise = {"kind": "constant", "sigma": 0.1}
    problem = problem_of(comm, common_tmp_path, basis=basis, noise=noise, freqs=(131e6, 140e6))
    both = zip(infer(comm, problem, "mixed"), infer(comm, problem, "double"), strict=True)
    for mixed, double in both:
        assert double.rounding_shift is None
        assert mixed.rounding_shift is not None
        assert 0 < moved(mixed, double) < 1.5 * mixed.rounding_shift < 1.5 * MOST_SHIFT
        assert mixed.rounding_shift < 100 * moved(mixed, double)


def test_errors_of_channels_with_one_beam_add_up(tmp_path: Path) -> None:
    noise, prior = {"kind": "constant", "sigma": 0.1}, {"frequency": {"kind": "modes", "n_modes": 1}}
    freqs = tuple(np.linspace(131e6, 133e6, 8).tolist())
    problem = problem_of(MPI.COMM_SELF, tmp_path, basis=REAL, noise=noise, prior=prior, freqs=freqs)
    for mixed, double in zip(*(infer(MPI.COMM_SELF, problem, one) for one in ("mixed", "double")), strict=True):
        assert mixed.rounding_shift is not None
        assert moved(mixed, double) < mixed.rounding_shift < MOST_SHIFT


def test_times_that_are_flagged_tell_nothing(tmp_path: Path) -> None:
    problem = problem_of(MPI.COMM_SELF, tmp_path, basis=REAL, freqs=(131e6, 132e6))
    rows = read_share(ProcessGrid.split(MPI.COMM_SELF, 2), problem, problem.train)
    every = Rounding(MPI.COMM_SELF, problem, rows)
    weights = rows.inv_noise_var.copy()
    weights[:, np.isin(rows.tile.times, every.sampled[:2])] = 0
    weights[1, : len(rows.tile.times) // 2] = 0
    found = Rounding(MPI.COMM_SELF, problem, replace(rows, inv_noise_var=weights)).sampled
    assert len(found) == min(len(every.sampled), np.count_nonzero((weights > 0).all(axis=(0, 2))))
    assert np.all(weights[:, np.isin(rows.tile.times, found)] > 0)


def test_where_it_would_move_further_all_is_double(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    # Data so good that seven digits do not suffice.
    problem = problem_of(MPI.COMM_SELF, tmp_path, noise={"kind": "constant", "sigma": 1e-6})
    (mixed,), (double,) = (infer(MPI.COMM_SELF, problem, precision) for precision in ("mixed", "double"))
    assert mixed.rounding_shift is not None
    assert mixed.rounding_shift > MOST_SHIFT
    np.testing.assert_array_equal(mixed.posterior.mean, double.posterior.mean)
    assert "all is computed in double" in capfd.readouterr().err


def test_effects_are_not_fitted_in_mixed_precision(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"\[solver\] precision: 'mixed' is for 'hydrabeam infer' without effects"):
        context_of(mock_job(solver={"precision": "mixed"}), tmp_path)
