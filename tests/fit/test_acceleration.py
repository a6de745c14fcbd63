"""Steps that learn from those before lead to where a fit ends in as many steps as there are slow directions."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py.MPI import COMM_SELF

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.sky.missing_sources import MissingSources
from hydrabeam_mpi.fit import gauss_newton
from hydrabeam_mpi.fit.acceleration import AHEAD, MEMORY, EarlierSteps, per_sigma
from hydrabeam_mpi.fit.beams_given import solve_beams
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.state import Ended, Values
from tests.fit.test_gauss_newton import free
from tests.loop.mock import context_of, mock_job


def better(earlier: EarlierSteps, std: FloatArray, point: FloatArray, step: FloatArray) -> FloatArray | None:
    """Return a better step of parameters alone."""
    earlier.add([point], [step])
    found = earlier.better_step(COMM_SELF, lambda difference: difference[0] / std)
    return None if found is None else found[0]


def test_as_many_steps_as_there_are_slow_directions() -> None:
    """Of a linear map, where each step by itself leaves 70% to 95% of the way in all of these."""
    rng = np.random.default_rng(1)
    left = np.ones(8)
    left[:MEMORY] = np.linspace(0.05, 0.3, MEMORY)
    axes = np.linalg.qr(rng.normal(size=(8, 8)))[0]
    matrix, end = axes @ np.diag(left) @ axes.T, rng.normal(size=8)
    std, at, earlier = rng.uniform(0.5, 2.0, 8), np.zeros(8), EarlierSteps()
    for _ in range(MEMORY + 2):
        step = (end - at) @ matrix
        further = better(earlier, std, at, step)
        at = at + (step if further is None else further)
    assert np.abs(at - end).max() < 1e-6


def test_a_point_is_all_that_the_next_step_depends_on() -> None:
    """What one part does makes the steps of the other, which would go to and fro without end."""
    end = np.array([1.0, -2.0])
    away = np.array([[0.0, -1.2], [1.1, 0.0]])
    earlier, at = EarlierSteps(), np.zeros(2)
    for _ in range(4):
        step = (at - end) @ (away - np.eye(2))
        earlier.add([at[:1], at[1:]], [step[:1], step[1:]])
        further = earlier.better_step(COMM_SELF, np.concatenate)
        at = at + (step if further is None else np.concatenate(further))
    assert np.abs(at - end).max() < 1e-6


def test_what_data_hardly_constrain_does_not_count() -> None:
    """Its variance may be below zero by rounding."""
    np.testing.assert_array_equal(per_sigma(np.array([2.0, 0.0, np.nan])), [0.5, 0.0, 0.0])


def test_steps_that_grow_are_gone_on_with() -> None:
    """Where a fit leaves a saddle the smallest step is behind it."""
    earlier, std = EarlierSteps(), np.ones(2)
    first = np.array([0.1, 0.0])
    assert better(earlier, std, np.array([1.0, 0.0]), first) is None
    second = np.array([0.12, 0.0])
    np.testing.assert_array_equal(better(earlier, std, np.array([1.1, 0.0]), second), AHEAD * second)


def test_what_is_forgotten_tells_nothing() -> None:
    earlier, step = EarlierSteps(), np.array([0.1])
    better(earlier, np.ones(1), np.zeros(1), step)
    earlier.forget()
    assert better(earlier, np.ones(1), step, 0.9 * step) is None


@pytest.mark.parametrize("flux", [0.01, 0.1])
def test_fits_that_leave_much_end_sooner_and_higher(
    flux: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One source is fitted where four are missing: what is left is up to fifteen times the noise."""
    sources = [(75.0, -26.0), (79.0, -34.0), (70.0, -33.0), (81.0, -27.0)]
    missing = {
        "kind": "missing_sources",
        "settings": {"sources": sources},
        "parameters": {f"source at ra={ra:.3f} dec={dec:.3f}: flux": flux for ra, dec in sources},
    }
    context = context_of(mock_job(missing, n_times=9), tmp_path)
    values = Values((free(context, MissingSources([(75.5, -26.6)]), flux),))
    calls = []

    def counted(*given: Any, **named: Any) -> Any:
        calls.append(given)
        return solve_beams(*given, **named)

    monkeypatch.setattr(gauss_newton, "solve_beams", counted)
    with_memory = refit(context, values).diagnostics
    n_calls = len(calls)
    assert with_memory.ended is Ended.CONVERGED
    monkeypatch.setattr(EarlierSteps, "better_step", lambda *_: None)
    without = refit(context, values).diagnostics
    assert with_memory.log_joint.sum() > without.log_joint.sum()
    assert len(calls) - n_calls > 1.3 * n_calls
