"""What is part of the model is weighed again as it was fitted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.instrument.cross_coupling import CrossCoupling
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.state import Active, Values
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
