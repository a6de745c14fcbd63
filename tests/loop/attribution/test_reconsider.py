"""What is part of the model is weighed again as it was fitted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.instrument.cross_coupling import CrossCoupling
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.state import Active, Values
from hydrabeam_mpi.fit.step import solved_at
from hydrabeam_mpi.loop.attribution.reconsider import Known, compare_priors
from tests.loop.mock import context_of, mock_job

COUPLED = {"kind": "cross_coupling", "settings": {"baselines": [[1, 4]]}, "parameters": {"baseline 1-4 real": 0.5}}


def test_beside_gains_an_effect_is_as_certain_as_where_it_was_fitted(tmp_path: Path) -> None:
    """What all gains have in common is held at zero: free, it would make the coupling uncertain in proportion."""
    context, prior_var = context_of(mock_job(COUPLED), tmp_path), 0.1**2
    coupling, gains = CrossCoupling([[1, 4]]), AntennaGains()
    active = []
    for effect in (coupling, gains):
        n = len(effect.parameters(context.setup))
        active.append(Active.start(effect, context.setup, np.full(n, prior_var), np.zeros((1, n))))
    fitted = refit(context, Values(tuple(active)))
    assert fitted.fit.std[0].max() < 0.001 * fitted.values.active[0].x[0, 0]
    own = fitted.values.active[0].prior_var(context.setup)
    _, given = compare_priors(context, fitted, Known.of(context, fitted), 0, own)
    assert given.std == pytest.approx(fitted.fit.std[0], rel=1e-4)


def test_what_is_known_without_an_effect_is_what_would_be_without_it(tmp_path: Path) -> None:
    """To first order, with the beam and the other effect where they are."""
    context = context_of(mock_job(COUPLED), tmp_path)
    couplings = CrossCoupling([[1, 4]]), CrossCoupling([[2, 5]])
    start = [Active.start(one, context.setup, np.full(2, 0.1**2), np.zeros((1, 2))) for one in couplings]
    fitted = refit(context, Values(tuple(start)))
    without = Known.of(context, fitted).without(context, 0)
    left = solved_at(context, fitted.values.without(0), fitted, keep=True)
    truth = Known.of(context, left)
    assert [one.effect for one in without.active] == [couplings[1]]
    assert without.by_channel is not None
    assert truth.by_channel is not None
    (found,), (expected,) = without.by_channel, truth.by_channel
    np.testing.assert_allclose(found.information, expected.information, rtol=1e-9)
    np.testing.assert_allclose(found.score, expected.score, rtol=0, atol=1e-6 * np.abs(expected.score).max())
