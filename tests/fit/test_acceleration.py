"""Steps that learn from those before lead to where a fit ends in as many steps as there are slow directions."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hydrabeam_mpi.effects.sky.missing_sources import MissingSources
from hydrabeam_mpi.fit import gauss_newton
from hydrabeam_mpi.fit.acceleration import AHEAD, MEMORY, EarlierSteps
from hydrabeam_mpi.fit.beams_given import solve_beams
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.state import Ended, Values
from tests.fit.test_gauss_newton import free
from tests.loop.mock import context_of, mock_job


def test_as_many_steps_as_there_are_slow_directions() -> None:
    """Of a linear map, where each step by itself leaves 70% to 95% of the way in all of these."""
    rng = np.random.default_rng(1)
    left = np.ones(8)
    left[:MEMORY] = np.linspace(0.05, 0.3, MEMORY)
    axes = np.linalg.qr(rng.normal(size=(8, 8)))[0]
    matrix, end = axes @ np.diag(left) @ axes.T, rng.normal(size=(1, 8))
    std, at, earlier = rng.uniform(0.5, 2.0, (1, 8)), np.zeros((1, 8)), EarlierSteps()
    for _ in range(MEMORY + 2):
        step = (end - at) @ matrix
        further = earlier.accelerated(at, step, std)
        at = at + (step if further is None else further)
    assert np.abs(at - end).max() < 1e-6


def test_what_data_hardly_constrain_does_not_count() -> None:
    """Its variance may be below zero by rounding."""
    earlier, std = EarlierSteps(), np.array([[1.0, np.nan]])
    assert earlier.accelerated(np.zeros((1, 2)), np.array([[0.5, 3.0]]), std) is None
    better = earlier.accelerated(np.array([[0.5, 3.0]]), np.array([[0.25, -7.0]]), std)
    assert better is not None
    assert better[0, 0] == pytest.approx(0.5)
    assert np.all(np.isfinite(better))


def test_steps_that_grow_are_gone_on_with() -> None:
    """Where a fit leaves a saddle the smallest step is behind it."""
    earlier, std = EarlierSteps(), np.ones((1, 2))
    first = np.array([[0.1, 0.0]])
    assert earlier.accelerated(np.array([[1.0, 0.0]]), first, std) is None
    second = np.array([[0.12, 0.0]])
    np.testing.assert_array_equal(earlier.accelerated(np.array([[1.1, 0.0]]), second, std), AHEAD * second)


def test_what_is_forgotten_tells_nothing() -> None:
    earlier, step = EarlierSteps(), np.array([[0.1]])
    earlier.accelerated(np.zeros((1, 1)), step, np.ones((1, 1)))
    earlier.forget()
    assert earlier.accelerated(step, 0.9 * step, np.ones((1, 1))) is None


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
    monkeypatch.setattr(EarlierSteps, "accelerated", lambda *_: None)
    without = refit(context, values).diagnostics
    assert with_memory.log_joint.sum() > without.log_joint.sum()
    assert len(calls) - n_calls > 1.3 * n_calls
