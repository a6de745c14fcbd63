"""What is known of the beams' precision serves where weights and sky are the same, and changes no result."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.instrument.cross_coupling import CrossCoupling
from hydrabeam_mpi.fit.beams_given import solve_beams
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.known_precision import RecentlyKnown
from hydrabeam_mpi.fit.state import Active, Estimate, Values
from tests.loop.mock import context_of, mock_job


def at(context: FitContext, effect: AntennaGains | CrossCoupling, value: float) -> Estimate:
    n = len(effect.parameters(context.setup))
    active = Active.start(effect, context.setup, np.ones(n), np.linspace(0.0, value, n)[np.newaxis])
    return Estimate(Values((active,)), refit(context, Values()).fit.posteriors)


def test_effects_that_add_leave_the_precision_as_it_is(tmp_path: Path) -> None:
    """Gains change the weights, and what is known serves again after them."""
    context = context_of(mock_job(), tmp_path)
    coupling = at(context, CrossCoupling([(0, 1)]), 0.3)
    alone = refit(context, Values()).fit.posteriors[0]
    solved = solve_beams(context, coupling)
    assert solved.beams[0].factor is alone.factor
    assert not np.allclose(solved.beams[0].mean, alone.mean)
    gains = solve_beams(context, at(context, AntennaGains(), 0.1))
    assert gains.beams[0].factor is not alone.factor
    assert solve_beams(context, coupling).beams[0].factor is alone.factor
    vars(context.train)["known"] = RecentlyKnown()
    anew = solve_beams(context, coupling)
    assert anew.beams[0].factor is not alone.factor
    np.testing.assert_array_equal(anew.beams[0].mean, solved.beams[0].mean)
    assert anew.beams[0].log_evidence == solved.beams[0].log_evidence
    np.testing.assert_array_equal(anew.train_chi2, solved.train_chi2)
    assert anew.reached == solved.reached
