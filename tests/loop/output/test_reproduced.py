"""What `infer` makes of an amended job is the fit that it was written from, to a millionth of its errors."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hydrabeam_mpi.effects.registry import EFFECTS, make_effect, make_reweighting
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.grown import grown_problem, marginal_beams
from hydrabeam_mpi.fit.joint import restore
from hydrabeam_mpi.fit.settle import settle
from hydrabeam_mpi.fit.state import Active, Fitted, Reweighted, Values
from hydrabeam_mpi.fit.whole_beams import with_whole_beams
from hydrabeam_mpi.inference.prior import ChannelPrior, DiagonalPrior
from hydrabeam_mpi.loop.output.amendment import amended_job
from hydrabeam_mpi.loop.selection.heldout_numbers import heldout_numbers
from tests.fit.test_gauss_newton import TWO, free
from tests.loop.mock import FREQ, context_of, mock_job, truth_of
from tests.loop.output.test_amendment import written_and_read

INJECTED: dict[str, dict[str, Any]] = {
    "diffuse": {"strength": 0.01, "settings": {"l_max": 2}},
    "missing_sources": {"strength": 3.0},
    "nonredundant_beams": {"strength": 0.02},
}
"""A tenth of the natural size where nothing else is said."""
FREQS = {
    "cable_reflections": tuple(140e6 + 1e6 * np.arange(4.0)),
    **dict.fromkeys(("antenna_delays", "spectral_index", "common_beam"), TWO),
}


def again(context: FitContext, fitted: Fitted, folder: Path) -> Fitted:
    """Return what `infer` comes to from the amended job."""
    job = written_and_read(amended_job(context.problem.job, fitted, context.setup), folder)
    return settle(context, refit(context, restore(job, context.setup)))


def assert_same(context: FitContext, one: Fitted, two: Fitted) -> None:
    """Compare effects, beams and held-out numbers, as they are written."""
    one, two = (with_whole_beams(context, fitted) for fitted in (one, two))
    for first, second, std, its_std in zip(one.values.active, two.values.active, one.fit.std, two.fit.std, strict=True):
        assert first.kind == second.kind
        assert np.all(np.abs(second.x - first.x) <= 1e-6 * std)
        np.testing.assert_allclose(its_std, std, rtol=1e-6)
    for own, other in zip(one.values.reweighted, two.values.reweighted, strict=True):
        np.testing.assert_array_equal(other.x, own.x)
    beams = zip(*(marginal_beams(context.setup, fit, context.channels) for fit in (one, two)), strict=True)
    for beam, its_beam in beams:
        assert np.all(np.abs(its_beam.mean - beam.mean) <= 1e-6 * beam.std)
        np.testing.assert_allclose(its_beam.std, beam.std, rtol=1e-6)
    numbers, its_numbers = (heldout_numbers(context, fit) for fit in (one, two))
    assert its_numbers.of_all == pytest.approx(numbers.of_all, rel=1e-6)


def fitted_to(context: FitContext, folder: Path, width: float = 0.3) -> Fitted:
    """Fit what was injected, as the loop does."""
    fitted = refit(context, Values())
    for truth in truth_of(folder):
        effect = make_effect(truth["kind"], truth["settings"])
        scale = max(width, 10.0 if effect.kind == "missing_sources" else 0.0)
        fitted = refit(context, fitted.values.extended(free(context, effect, scale)), fitted)
    return settle(context, fitted)


@pytest.mark.parametrize("kind", EFFECTS)
def test_every_effect(kind: str, tmp_path: Path) -> None:
    injected = {"kind": kind, **INJECTED.get(kind, {"strength": 0.1})}
    job = mock_job(injected, freqs=FREQS.get(kind, (FREQ,)))
    context = context_of(job, tmp_path)
    fitted = fitted_to(context, tmp_path)
    assert np.any(np.abs(fitted.values.active[0].x) > 1e-3 * fitted.fit.std[0])
    assert_same(context, fitted, again(context, fitted, tmp_path))


def test_two_effects_with_other_weights_in_a_basis_that_grew(tmp_path: Path) -> None:
    """In two channels with priors of their own, from other values than those it ends at."""
    injected = [{"kind": kind, "strength": 0.1} for kind in ("antenna_gains", "basis_truncation", "timestamp")]
    context = context_of(mock_job(*injected, freqs=TWO), tmp_path)
    fitted = fitted_to(context, tmp_path)
    first, *others = fitted.values.active
    widths = np.array([1.0, 2.0])[:, np.newaxis] * first.prior.of(0).std()
    scales, unknown = np.ones((2, 2, len(context.setup.times)))
    scales[0, 3], scales[:, 4], unknown[:, 5] = 20.0, 30.0, 4.0
    of_baselines = np.ones((2, context.setup.observation.Nbls))
    of_baselines[:, 5] = 10.0
    weights = {
        "noise_level": np.array([[1.5], [1.2]]),
        "bad_integrations": scales,
        "unknown_integrations": unknown,
        "bad_baselines": of_baselines,
    }
    values = Values(
        (_with_widths(first, widths), *others),
        tuple(Reweighted(make_reweighting(kind, {}), x, 0.1 * x) for kind, x in weights.items()),
    )
    fitted = settle(context, refit(context, values, fitted))
    job = amended_job(context.problem.job, fitted, context.setup)
    np.testing.assert_allclose(job.effects[0].prior_std, widths, rtol=1e-14)
    assert [len(entry.prior_std) for entry in job.effects] == [2, 1, 1, 0, 0, 0, 0]
    assert_same(context, fitted, again(context, fitted, tmp_path))
    basis = grown_problem(context.problem, context.setup, fitted.values).basis
    assert basis.n_modes == context.problem.basis.n_modes + len(fitted.values.active[1].used)


def _with_widths(active: Active, widths: Any) -> Active:
    return replace(active, prior=ChannelPrior(tuple(DiagonalPrior(np.zeros(len(row)), row) for row in widths)))
