"""Where effects alone are known, a fit begins with the beams that belong to them, however strongly they are seen."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hydrabeam_mpi.effects.instrument.auto_coupling import AutoCoupling
from hydrabeam_mpi.fit.beams_given import solve_beams
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import MAX_STEPS, refit
from hydrabeam_mpi.fit.own_beams import with_own_beams
from hydrabeam_mpi.fit.settle import settle
from hydrabeam_mpi.fit.state import Active, Estimate, Values
from hydrabeam_mpi.fit.step import beam_moved
from tests.loop.mock import context_of, mock_job

STILL = 1e-6


@pytest.fixture(scope="module")
def context(tmp_path_factory: pytest.TempPathFactory) -> FitContext:
    return context_of(mock_job(), tmp_path_factory.mktemp("own"))


def coupled(context: FitContext, size: float) -> Values:
    """Every baseline has this much of the autocorrelations, which the beams see."""
    effect = AutoCoupling([tuple(pair) for pair in context.setup.observation.antpairs.tolist()])
    n = len(effect.parameters(context.setup))
    return Values((Active.start(effect, context.setup, np.ones(n), np.full((1, n), size)),))


def turn(context: FitContext, at: Estimate) -> tuple[Estimate, float]:
    """Solve for the beams, and return how far they move."""
    beams = solve_beams(context, at).beams
    return replace(at, beams=beams), beam_moved(context, at.beams, beams)


@pytest.mark.parametrize(("size", "grows"), [(0.1, False), (1.5, True)])
def test_beams_are_those_that_the_effects_are_seen_by(context: FitContext, size: float, grows: bool) -> None:
    """Where turns by themselves end, and where they go ever further."""
    at, moves = turn(context, Estimate(coupled(context, size)))[0], []
    for _ in range(6):
        at, moved = turn(context, at)
        moves.append(moved)
    assert (moves[-1] > moves[1]) == grows
    at = with_own_beams(context, Estimate(coupled(context, size)), MAX_STEPS, STILL)
    assert turn(context, at)[1] < 10 * STILL


def test_a_fit_is_found_again_from_its_effects_alone(tmp_path: Path) -> None:
    pairs = [[0, 3], [1, 4], [2, 5]]
    parameters = {f"baseline {one}-{two} real": 0.3 for one, two in pairs}
    context = context_of(
        mock_job({"kind": "auto_coupling", "settings": {"baselines": pairs}, "parameters": parameters}), tmp_path
    )
    effect = AutoCoupling([(one, two) for one, two in pairs])
    start = Active.start(effect, context.setup, np.ones(6), np.zeros((1, 6)))
    fitted = settle(context, refit(context, Values((start,))))
    assert np.abs(fitted.values.x[0, ::2] - 0.3).max() < 0.05
    again = refit(context, fitted.values)
    assert np.all(np.abs(again.values.x - fitted.values.x) < 1e-3 * fitted.fit.std[0])
