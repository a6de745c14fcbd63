"""Which element of an effect matters most is told by fits, as far as these are worth it."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from hydrabeam_mpi.effects.sky.missing_sources import MissingSources
from hydrabeam_mpi.effects.sky.moving_sources import MovingSources
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import BrokenOff, Underway, refit
from hydrabeam_mpi.fit.state import Fitted, Values
from hydrabeam_mpi.loop.attribution.score_effects import Finding, attribute, weigh_as_they_are
from hydrabeam_mpi.loop.selection.acceptance import Candidate
from hydrabeam_mpi.loop.selection.candidate_fits import fit_candidate
from hydrabeam_mpi.loop.selection.foremost import fit_foremost
from hydrabeam_mpi.loop.selection.predictions import check
from hydrabeam_mpi.loop.selection.refits import log_joint
from tests.loop.mock import context_of, mock_job

SOURCE, FLUX = (31.37, -28.64), 3.0
ADDED = {
    "kind": "missing_sources",
    "settings": {"sources": [SOURCE]},
    "parameters": {"source at ra=31.370 dec=-28.640: flux": FLUX},
}


@pytest.fixture(scope="module")
def context(tmp_path_factory: pytest.TempPathFactory) -> FitContext:
    return context_of(mock_job(ADDED), tmp_path_factory.mktemp("foremost"))


@pytest.fixture(scope="module")
def before(context: FitContext) -> Fitted:
    return refit(context, Values())


@pytest.fixture(scope="module")
def finding(context: FitContext, before: Fitted) -> Finding:
    """Of the places where there may be a source the likeliest alone, though others come near."""
    (found,) = attribute(context, before, [MissingSources()])
    element = found.effect.parameters(context.setup).element
    likeliest = element == element[np.argmax(found.evidence.alone)]
    prior_var = np.where(likeliest, found.evidence.prior_var, 0.0)
    assert prior_var.any()
    return replace(found, evidence=replace(found.evidence, prior_var=prior_var))


def test_the_likeliest_is_fitted(context: FitContext, before: Fitted, finding: Finding) -> None:
    fitted = fit_foremost(context, before, finding, lambda at: True)
    assert fitted is not None
    last = fitted.values.active[-1]
    assert len(np.unique(last.effect.parameters(context.setup).element[last.used])) == 1
    told = last.effect.told(context.setup, last.x, fitted.fit.std[-1])
    own = last.used[:3]
    assert np.all(np.abs(told.values[0, own] - [FLUX, *SOURCE]) < 4 * told.std[0, own])


def test_one_that_is_not_worth_it_is_broken_off_wherever_it_may_be(
    context: FitContext, before: Fitted, finding: Finding
) -> None:
    begun = []

    def never(at: Underway) -> bool:
        begun.append(at)
        return False

    assert fit_foremost(context, before, finding, never) is None
    assert len(begun) > 1


def test_of_several_the_foremost_alone_says_nothing_of_what_all_are_worth(
    context: FitContext, before: Fitted, finding: Finding
) -> None:
    places = finding.effect.parameters(context.setup).nonlinear
    every = np.where(places, 0.0, finding.evidence.prior_var.max())
    several = replace(finding, evidence=replace(finding.evidence, prior_var=every))
    assert fit_foremost(context, before, several, lambda at: False) is not None


def test_what_moves_is_found_from_another_grating_lobe(tmp_path: Path) -> None:
    """Of twenty lobes only those are fitted that come near the likeliest by the linear model."""
    place, rate, flux = (97.0, -26.0), (6.0, -4.0), 30.0
    added = {
        "kind": "moving_sources",
        "settings": {"sources": [place], "rates": [rate]},
        "parameters": {"source at ra=97.000 dec=-26.000: flux": flux},
    }
    job = mock_job(added)
    job["data"]["simulate"]["lst_range"] = [6.0, 7.0]
    context = context_of(job, tmp_path)
    before, setup = refit(context, Values()), context.setup
    truth = MovingSources([place], 1, [rate]).in_full(setup)
    lobes = list(islice(truth.alike(setup, np.zeros((1, 5)), 0), 2))
    rates = [lobe.rates[0].tolist() for lobe in lobes]
    wrong = MovingSources([lobe.sources[0] for lobe in lobes], 1, rates).in_full(setup)
    (evidence,) = weigh_as_they_are(context, before, [wrong])
    fitted = fit_foremost(context, before, Finding(wrong, evidence))
    assert fitted is not None
    last = fitted.values.active[-1]
    told = last.effect.told(setup, last.x, fitted.fit.std[-1])
    (own,) = np.unique(last.used // 5)
    # Lobes are ten degrees apart. The flux goes with the beam there, which is not quite in the basis.
    np.testing.assert_allclose(told.values[0, 5 * own + 1 : 5 * own + 5], [*place, *rate], atol=1e-3)
    assert told.values[0, 5 * own] == pytest.approx(flux, rel=0.1)


def test_once_it_is_fitted_all_are_asked_what_they_are_worth(
    context: FitContext, before: Fitted, finding: Finding
) -> None:
    """By what has been reached, and what weighing all again promises beyond."""
    places = finding.effect.parameters(context.setup).nonlinear
    every = np.where(places, 0.0, finding.evidence.prior_var.max())
    several = Candidate.of(replace(finding, evidence=replace(finding.evidence, prior_var=every)))
    asked = []

    def never(at: Underway) -> bool:
        asked.append(at)
        return False

    with pytest.raises(BrokenOff, match="does not come near"):
        fit_candidate(context, check(context, before), several, never)
    (once,) = asked
    assert once.reached > log_joint(context, before) + 100
    assert once.expected >= 0
    # As many parameters as of all that were weighed need not have stayed.
    assert once.price is not None
    assert 0 < once.price <= several.finding.evidence.linear_gain - several.log_bayes_factor
