"""A source with a flux below zero is left out, and true ones beside it stay, whatever the model lacks besides."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hydrabeam_mpi.effects.sky.catalogue_flux import CatalogueFlux
from hydrabeam_mpi.effects.sky.missing_sources import MissingSources
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.error_scale import error_scale
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.state import Active, Fitted, Values
from hydrabeam_mpi.loop.attribution.evidence import Evidence
from hydrabeam_mpi.loop.attribution.limits import is_unphysical
from hydrabeam_mpi.loop.attribution.score_effects import Finding
from hydrabeam_mpi.loop.selection import candidate_fits
from hydrabeam_mpi.loop.selection.acceptance import Candidate
from hydrabeam_mpi.loop.selection.physical import leave_out_unphysical, price_of_fitted
from hydrabeam_mpi.loop.selection.predictions import check
from hydrabeam_mpi.loop.selection.refits import fit_patiently, rise
from hydrabeam_mpi.loop.selection.taken_back import take_back_unphysical
from hydrabeam_mpi.loop.selection.trials import try_effects
from tests.loop.made import effect_candidate, round_of
from tests.loop.mock import context_of, mock_job

TRUE, FALSE = (31.37, -28.64), (20.0, -33.0)
"""Right ascension and declination, degrees, of a source that the catalogue lacks, and of one with a flux below zero."""


def source(place: tuple[float, float], flux: float) -> dict[str, Any]:
    name = f"source at ra={place[0]:.3f} dec={place[1]:.3f}: flux"
    return {"kind": "missing_sources", "settings": {"sources": [list(place)]}, "parameters": {name: flux}}


@pytest.fixture(scope="module")
def context(tmp_path_factory: pytest.TempPathFactory) -> FitContext:
    return context_of(mock_job(source(TRUE, 3.0), source(FALSE, -3.0)), tmp_path_factory.mktemp("physical"))


def fit_of(context: FitContext, *places: tuple[float, float]) -> Fitted:
    effect, used = MissingSources(places, 1000), np.tile([1.0, 0.0, 0.0], len(places))
    return refit(context, Values((Active.start(effect, context.setup, used, np.zeros((1, len(used)))),)))


@pytest.mark.parametrize(
    ("sigmas", "gone"),
    [(0.0, False), (3.0, False), (3.16, False), (3.17, True), (np.inf, True)],
)
def test_beyond_by_more_than_what_is_believed(sigmas: float, gone: bool) -> None:
    """e^5 to one is 3.16 standard errors."""
    assert is_unphysical(np.array([0.0, sigmas]), 5.0).tolist() == [False, gone]


def test_a_true_source_stays_beside_a_false_one(context: FitContext) -> None:
    fitted = fit_of(context, FALSE, TRUE)
    assert fitted.values.active[0].x[0, 0] < -2
    found = leave_out_unphysical(context, fitted, 0)
    assert found is not None
    assert found.places == {0: 0}
    assert found.values.active[0].effect.describe() == {"sources": [list(TRUE)], "trials": 1000}
    words = "missing point sources: left out what would have a flux below zero: source at ra=20"
    assert found.told[0].startswith(words)
    assert leave_out_unphysical(context, fitted, 1) is None  # the job's own
    again = refit(context, found.values, fitted)
    assert leave_out_unphysical(context, again, 0) is None
    assert again.values.active[0].x[0, 0] > 2


def test_errors_are_larger_where_something_is_left(context: FitContext) -> None:
    fitted = fit_of(context, FALSE)
    std = float(fitted.fit.std[0][0, 0])
    beyond = float(-fitted.values.active[0].x[0, 0] / std)
    for share, gone in ((0.5, False), (2.0, True)):
        chi2 = np.full_like(fitted.diagnostics.train_chi2, beyond**2 / 10 / share)
        wrong = replace(fitted, diagnostics=replace(fitted.diagnostics, train_chi2=chi2))
        assert (leave_out_unphysical(context, wrong, 0) is not None) == gone


def test_what_is_beyond_its_limits_costs_evidence(context: FitContext) -> None:
    """As much as the likelihood is less without that source, which is one of no flux."""
    without = refit(context, Values())
    for places in ((FALSE,), (TRUE,)):
        fitted = fit_of(context, *places)
        ((flux, *_),) = fitted.values.active[0].x
        scale = error_scale(context, fitted).channels[0]
        expected = 0.0 if flux > 0 else rise(context, without, fitted) / scale**2
        assert price_of_fitted(context, fitted) == pytest.approx(expected, rel=1e-3)
        assert (expected > 0) == (places == (FALSE,))


def test_likelihoods_tell_what_errors_do_not(context: FitContext) -> None:
    """As where flux and beam are factors of each other, of which each has an error as large as itself."""
    fitted = fit_of(context, FALSE, TRUE)
    wide = replace(fitted, fit=replace(fitted.fit, std=(np.maximum(fitted.fit.std[0], 2.0),)))
    assert leave_out_unphysical(context, wide, 0) is None
    found = leave_out_unphysical(context, wide, 0, by_likelihood=True)
    assert found is not None
    assert found.values.active[0].effect.describe() == {"sources": [list(TRUE)], "trials": 1000}
    alone = fit_of(context, TRUE)
    assert leave_out_unphysical(context, alone, 0, by_likelihood=True) is None


def test_what_is_unphysical_at_the_end_is_taken_back(context: FitContext) -> None:
    before = check(context, refit(context, Values()))
    for places, kept, n_left in (((FALSE, TRUE), 0, 1), ((FALSE,), None, 0)):
        fitted = fit_of(context, *places)
        one = round_of(effect_candidate(fitted.values.active[0].effect), before, check(context, fitted))
        last, now, asked = take_back_unphysical(context, one, 0)
        assert (now, asked, len(last.after.fitted.values.active)) == ({0: kept}, {}, n_left)
        assert "left out what would have a flux below zero" in last.revised[0]
    assert take_back_unphysical(context, one, 1) == (one, {0: 0}, {})


def test_trials_leave_out_what_cannot_be(context: FitContext) -> None:
    """Nothing that can be is lost; where nothing is left the effect is refused."""
    before = check(context, refit(context, Values()))
    for places, n_left in (((FALSE, TRUE), 1), ((FALSE,), 0)):
        effect, used = MissingSources(places, 1000), np.tile([1.0, 0.0, 0.0], len(places))
        evidence = Evidence(1e4, used, np.zeros((1, len(used))), 0.0, 1.0, 0.0, len(used), 0.0)
        candidate = replace(effect_candidate(effect, 1e4), finding=Finding(effect, evidence))
        tried: list[Any] = []
        found = try_effects(context, before, [candidate], tried)
        assert (found is not None) == bool(n_left)
        if found is not None:
            (active,) = found.after.fitted.values.active
            assert found.candidate.finding is not None
            assert found.candidate.finding.effect is active.effect
            assert active.effect.describe() == {"sources": [list(TRUE)], "trials": 1000}
            assert active.x[0, 0] > 2
        else:
            assert tried[0][1] == "all that is left of it would have a flux below zero"


def test_what_cannot_be_at_the_linear_optimum_is_left_out_before_the_first_fit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of fluxes, which the linear model tells as well as a fit."""
    plain = context_of(mock_job(), tmp_path / "plain")
    effect = CatalogueFlux().foremost(plain.setup, 2)
    names = effect.parameters(plain.setup).names
    wrong = dict(zip(names, (0.5, -1.2), strict=True))
    told = {"kind": "catalogue_flux", "settings": effect.describe(), "parameters": wrong}
    context = context_of(mock_job(told), tmp_path / "wrong")
    fits: list[tuple[str, ...]] = []

    def noted(context: FitContext, values: Values, *args: Any) -> Fitted:
        fits.append(values.active[-1].effect.parameters(context.setup).names)
        return fit_patiently(context, values, *args)

    monkeypatch.setattr(candidate_fits, "fit_patiently", noted)
    evidence = Evidence(1e7, np.full(2, 10.0), np.array([[0.5, -1.2]]), 0.0, 2.0, 0.0, 2, 0.0)
    try_effects(context, check(context, refit(context, Values())), [Candidate.of(Finding(effect, evidence))], [])
    assert fits[0] == names[:1]
