from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from astropy import units as u
from astropy.coordinates import FK5, EarthLocation, SkyCoord
from astropy.time import Time
from scipy.spatial.transform import Rotation

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.instrument.orientation import Fixed, Orientation
from hydrabeam_mpi.effects.instrument.timestamp import Timestamp
from hydrabeam_mpi.fit.gauss_newton import BrokenOff, Underway, refit
from hydrabeam_mpi.fit.state import Active, Values
from hydrabeam_mpi.loop.attribution.score_effects import attribute
from hydrabeam_mpi.loop.selection.acceptance import Candidate
from hydrabeam_mpi.loop.selection.candidate_fits import fit_candidate
from hydrabeam_mpi.loop.selection.predictions import check
from hydrabeam_mpi.loop.selection.refits import log_joint, with_best_variant
from hydrabeam_mpi.model.positions import RotatedPositions
from tests.effects.direct import assert_same, row_vectors, visibilities
from tests.effects.small import small_block, small_setup, with_effect
from tests.loop.mock import context_of, mock_job

SETUP = small_setup(n_sources=500)
ARCMIN = np.deg2rad(1 / 60)


def seen(effect: Orientation, x: list[float]) -> tuple[FloatArray, FloatArray]:
    """Visibilities with the effect, and the small scene's own."""
    block = small_block(SETUP)
    block.integrate_for([effect])
    return with_effect(effect, block, np.array(x)), block.vis


def test_a_latitude_that_is_wrong_is_a_turn_about_east() -> None:
    """North of where it is said to be sources are seen further South."""
    block = small_block(SETUP)
    observation = SETUP.observation
    at = observation.location
    elsewhere = replace(observation, location=EarthLocation.from_geodetic(at.lon, at.lat + 30 * u.arcmin, at.height))
    there = replace(block, positions=RotatedPositions(SETUP.sky, elsewhere))
    assert_same(seen(Orientation(), [30.0, 0.0, 0.0])[0], visibilities(there), block)


def test_a_survey_that_missed_north_turns_the_array_and_no_beam() -> None:
    block = small_block(SETUP)
    turned = Rotation.from_rotvec([0, 0, -40 * ARCMIN]).apply(row_vectors(block))
    effect, x = Orientation("array"), np.array([[0.0, 0.0, 40.0]])
    assert_same(seen(effect, x[0].tolist())[0], visibilities(block, vectors=turned), block)
    told = effect.told(SETUP, x, np.ones((1, 3)))
    assert told.names[2] == "sky turned, but not on the beam, about Up"
    np.testing.assert_array_equal(told.values, x)


def test_coordinates_of_another_epoch_turn_the_stars() -> None:
    """By 26 years of precession, of which astropy knows the rotation; over six hours no other axis does that."""
    block, sky = small_block(SETUP), SETUP.sky
    of_date = SkyCoord(sky.ra, sky.dec, unit="rad", frame=FK5(equinox="J2000")).transform_to(
        FK5(equinox=Time(2026, format="jyear"))
    )
    moved = replace(sky, ra=of_date.ra.rad, dec=of_date.dec.rad)
    truth = visibilities(replace(block, positions=RotatedPositions(moved, SETUP.observation)))
    axes = SkyCoord([0, 90, 0], [0, 0, 90], unit="deg", frame=FK5(equinox="J2000"))
    matrix = axes.transform_to(FK5(equinox=Time(2026, format="jyear"))).cartesian.xyz.value
    vector = Rotation.from_matrix(matrix).as_rotvec() / ARCMIN
    effect = Orientation("stars", lst=5.0).in_full(SETUP)
    x = np.linalg.solve(told_of(effect, np.eye(3)), vector)
    assert_same(seen(effect, x.tolist())[0], truth, block, rtol=1e-8)
    np.testing.assert_allclose(vector, [0, -8.7, 20.0], atol=0.15)  # about the pole of the ecliptic, 50.3 arcsec a year


def told_of(effect: Orientation, x: FloatArray) -> FloatArray:
    """Return what is told of these parameters, a row each, as columns."""
    return np.array([effect.told(SETUP, row[np.newaxis], row[np.newaxis]).values[0] for row in x]).T


def test_a_clock_is_a_turn_about_the_pole() -> None:
    """However the axis is fixed; 15 arcsec a second, from East to West."""
    block, clock = small_block(SETUP), Timestamp()
    block.integrate_for([clock])
    late = with_effect(clock, block, np.array([80.0]))
    pole = np.array([0, np.cos(SETUP.observation.latitude), np.sin(SETUP.observation.latitude)])
    for fixed in ("ground", "stars"):
        x = -80 * 15.041 / 60 * pole
        assert_same(seen(Orientation(fixed), x.tolist())[0], late, block, rtol=1e-4)
    told = Orientation("stars").told(SETUP, x[np.newaxis], np.ones((1, 3)))
    np.testing.assert_allclose(told.values, [[0, 0, -80 * 15.041 / 60]], atol=1e-9)
    np.testing.assert_allclose(told.std, 1.0)
    assert told.names == tuple(
        f"stars turned about {axis}" for axis in ("RA 0 h, Dec 0", "RA 6 h, Dec 0", "the North pole")
    )


def test_the_stars_keep_their_axis_in_other_data() -> None:
    """In those of other times the same sky is turned by the same parameters."""
    effect = Orientation("stars").in_full(SETUP)
    later = replace(SETUP, observation=replace(SETUP.observation, lsts=SETUP.observation.lsts + 1.0))
    assert effect.in_full(later).describe() == effect.describe()
    assert Orientation("stars").in_full(later).describe() != effect.describe()


@pytest.mark.parametrize("fixed", ["stars", "array"])
def test_the_fit_tells_what_is_turned(fixed: Fixed, tmp_path: Path) -> None:
    truth = {"turn about East": 12.0, "turn about North": -5.0, "turn about Up": 8.0}
    context = context_of(mock_job({"kind": "orientation", "settings": {"fixed": fixed}, "parameters": truth}), tmp_path)
    start = Active.start(Orientation().in_full(context.setup), context.setup, np.full(3, 100.0), np.zeros((1, 3)))
    fitted = with_best_variant(context, refit(context, Values((start,))))
    (active,) = fitted.values.active
    assert active.effect.describe()["fixed"] == fixed
    assert fitted.diagnostics.train_chi2[0] < 1.2
    # What the middle of the data is the simulation knows as well.
    assert np.all(np.abs(active.x[0] - list(truth.values())) < 4 * fitted.fit.std[0][0])


def test_a_form_that_is_not_worth_its_fit_gives_way_to_the_next(tmp_path: Path) -> None:
    """By the linear model another form of a turn by a degree comes first, whose fit does not come as far."""
    truth = {"turn about East": 50.0, "turn about North": -40.0, "turn about Up": 30.0}
    stars = {"kind": "orientation", "settings": {"fixed": "stars"}, "parameters": truth}
    context = context_of(mock_job(stars), tmp_path)
    before = check(context, refit(context, Values()))
    found = Candidate.of(attribute(context, before.fitted, [Orientation("array")])[0])
    alone, _ = fit_candidate(context, before, found)
    assert alone.finding is not None
    assert alone.finding.effect.describe()["fixed"] == "stars"
    # The others come to less than nine tenths of it.
    most = log_joint(context, before.fitted) + 0.95 * alone.log_bayes_factor

    def is_worth_it(at: Underway) -> bool:
        return at.reached + 10 * at.expected > most

    again, _ = fit_candidate(context, before, found, is_worth_it)
    assert again.finding is not None
    assert again.finding.effect.describe()["fixed"] == "stars"
    with pytest.raises(BrokenOff):
        fit_candidate(context, before, found, lambda at: False)
