"""A source that was found where the catalogue has one is an error of that one's flux, if that is likelier."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hydrabeam_mpi.effects.sky.catalogue_flux import CatalogueFlux
from hydrabeam_mpi.effects.sky.missing_sources import MissingSources
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.state import Active, Values
from hydrabeam_mpi.loop.selection.acceptance import Round
from hydrabeam_mpi.loop.selection.known_elements import as_known
from hydrabeam_mpi.loop.selection.predictions import check
from tests.loop.made import effect_candidate, round_of
from tests.loop.mock import context_of, mock_job

TRIALS = 100


def fitted_as_sources(context: FitContext, *sources: tuple[float, float]) -> Round:
    """A round that has found missing sources at some places."""
    effect = MissingSources(sources, TRIALS)
    n = len(effect.parameters(context.setup))
    var, x = np.zeros(n), np.zeros((1, n))
    var[::3], x[:, ::3] = 100.0, 1.0
    before = check(context, refit(context, Values()))
    after = check(context, refit(context, Values((Active.start(effect, context.setup, var, x),)), before.fitted))
    return round_of(effect_candidate(effect), before, after)


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> FitContext:
    return context_of(mock_job(), tmp_path_factory.mktemp("plain"))


def brightest(context: FitContext) -> tuple[float, float]:
    """The catalogue source that the model beam sees brightest."""
    return CatalogueFlux().foremost(context.setup, 1).sources[0]


def with_wrong_flux(plain: FitContext, folder: Path) -> FitContext:
    """Data in which that has 30% more than in the catalogue, and a source is missing."""
    flux = {"kind": "catalogue_flux", "settings": {"sources": [list(brightest(plain))]}, "strength": 3.0}
    missing = {"kind": "missing_sources", "settings": {"sources": [list(place_of_missing(plain))]}, "strength": 10.0}
    return context_of(mock_job(flux, missing), folder)


def place_of_missing(plain: FitContext) -> tuple[float, float]:
    """A place as high as that of the brightest, and six degrees from it."""
    ra, dec = brightest(plain)
    return (ra + 6.0) % 360, dec


def test_a_source_where_the_catalogue_has_one_is_its_flux(plain: FitContext, tmp_path: Path) -> None:
    """And the one beside it, where the catalogue has none, stays what it is."""
    context = with_wrong_flux(plain, tmp_path)
    ra, dec = brightest(plain)
    found = fitted_as_sources(context, (ra + 0.3, dec - 0.2), place_of_missing(plain))
    assert found.after.score.chi2 == pytest.approx(1, abs=0.1)
    added, places = as_known(context, found.after, [found], [CatalogueFlux()], []) or pytest.fail("nothing was found")
    assert places == {0: 0, 1: 1}
    assert "taken back, as it is one of the fluxes of catalogue sources" in added.revised[0]
    source, flux = added.after.fitted.values.active
    assert isinstance(source.effect, MissingSources)
    assert source.effect.sources == (place_of_missing(plain),)
    assert isinstance(flux.effect, CatalogueFlux)
    assert flux.effect.sources == (brightest(plain),)
    error, std = flux.x[0, 0], added.after.fitted.fit.std[1][0, 0]
    assert abs(abs(error) - 0.3) < 4 * std < 0.04
    assert added.after.score.chi2 == pytest.approx(1, abs=0.1)
    # Where it is not to be looked for it is not told so.
    assert as_known(context, found.after, [found], [], []) is None


def test_the_effect_is_gone_with_its_last_source(plain: FitContext, tmp_path: Path) -> None:
    flux = {"kind": "catalogue_flux", "settings": {"sources": [list(brightest(plain))]}, "strength": 3.0}
    context = context_of(mock_job(flux), tmp_path)
    ra, dec = brightest(plain)
    found = fitted_as_sources(context, (ra + 0.3, dec - 0.2))
    added, places = as_known(context, found.after, [found], [CatalogueFlux()], []) or pytest.fail("nothing was found")
    assert places == {0: None, 1: 0}
    (flux_of_known,) = added.after.fitted.values.active
    assert isinstance(flux_of_known.effect, CatalogueFlux)


def test_a_source_near_a_known_one_stays_where_it_is(plain: FitContext, tmp_path: Path) -> None:
    """It is told from the other by its place, which differs by many of its standard errors."""
    ra, dec = brightest(plain)
    beside = (ra + 2.0, dec)
    missing = {"kind": "missing_sources", "settings": {"sources": [list(beside)]}, "strength": 10.0}
    context = context_of(mock_job(missing), tmp_path)
    found = fitted_as_sources(context, beside)
    assert as_known(context, found.after, [found], [CatalogueFlux()], []) is None
