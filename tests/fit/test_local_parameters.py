"""Parameters of single held-out times are found on these times, however far they are from where they begin."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hydrabeam_mpi.effects.registry import make_effect
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.heldout import whiten
from hydrabeam_mpi.fit.local_parameters import fit_local, untold
from hydrabeam_mpi.fit.state import Active, Values
from tests.loop.mock import context_of, mock_job, truth_of


@pytest.mark.parametrize("strength", [10.0, 60.0])
def test_gains_of_each_time(strength: float, tmp_path: Path) -> None:
    """Of a tenth, and of factors of up to four, where Newton's steps of a logarithm go too far either way."""
    settings = {"gains_of": [[1, "ln amplitude"], [1, "phase"]]}
    job = mock_job({"kind": "gain_jitter", "settings": settings, "strength": strength}, n_times=24)
    context = context_of(job, tmp_path)
    effect = make_effect("gain_jitter", settings)
    size = np.full(len(effect.parameters(context.setup)), strength * 0.01)
    fitted = refit(context, Values((Active.start(effect, context.setup, size**2, np.zeros_like(size)),)))
    assert untold(context, fitted.values) == "times"
    found, which = fit_local(context, fitted, "times")
    assert np.array_equal(found.values.x[0, ~which], fitted.values.x[0, ~which])
    (truth,) = truth_of(tmp_path)
    assert context.setup.fitted is not None
    is_heldout = np.tile(~np.isin(context.setup.times, context.setup.fitted), 2)
    assert np.array_equal(which, is_heldout)
    off = found.values.x[0, which] - np.array(truth["values"][0])[which]
    std = np.sqrt(np.diag(found.fit.covariances[0])[which])
    assert np.abs(off / std).max() < 5
    z = whiten(context, fitted).z[0]
    assert np.mean(np.abs(z) ** 2) / 2 == pytest.approx(1.0, abs=5 / np.sqrt(z.size))
