from __future__ import annotations

import numpy as np
import pytest
from numpy.polynomial.hermite_e import hermegauss

from hydrabeam_mpi.effects.shared.point_sources import responses
from hydrabeam_mpi.effects.sky.elongated_source import ElongatedSource
from hydrabeam_mpi.effects.sky.resolved_source import ResolvedSource
from tests.effects.small import small_block, small_setup

SETUP = small_setup((131e6,), n_times=3)
INDEX = 4
PLACE = np.rad2deg([[SETUP.sky.ra[INDEX], SETUP.sky.dec[INDEX]]]).tolist()


def squares(major: float, minor: float, angle: float) -> list[float]:
    """Return the parameters of axes (arcmin) and position angle (deg)."""
    mean, r, twice = 0.5 * (major**2 + minor**2), 0.5 * (major**2 - minor**2), np.deg2rad(2 * angle)
    return [mean, r * np.cos(twice), r * np.sin(twice)]


@pytest.mark.parametrize("angle", [0.0, 40.0, 90.0, 155.0])
def test_it_is_many_points_along_its_axes(angle: float) -> None:
    """On a grid by which a Gaussian is integrated, each point with its own beam and fringes."""
    block, (nodes, weights), major, minor = small_block(SETUP), hermegauss(15), 20.0, 8.0
    ra, dec = SETUP.sky.ra[INDEX], SETUP.sky.dec[INDEX]
    along, across = (np.deg2rad(one / 60) / np.sqrt(8 * np.log(2)) * nodes for one in (major, minor))
    east = np.array([-np.sin(ra), np.cos(ra), 0.0])
    north = np.array([-np.sin(dec) * np.cos(ra), -np.sin(dec) * np.sin(ra), np.cos(dec)])
    turn = np.deg2rad(angle)
    one, two = np.cos(turn) * north + np.sin(turn) * east, np.cos(turn) * east - np.sin(turn) * north
    points = np.cross(east, north) + along[:, np.newaxis, np.newaxis] * one + across[:, np.newaxis] * two
    x, y, z = points.reshape(-1, 3).T
    share = np.outer(weights, weights).ravel() / weights.sum() ** 2
    wide = responses(block, np.arctan2(y, x), np.arcsin(z / np.hypot(np.hypot(x, y), z))) @ share
    change = SETUP.sky.flux[0, INDEX] * block.spread(wide - responses(block, np.array([ra]), np.array([dec]))[..., 0])
    effect = ElongatedSource(PLACE)
    found = effect.added(block, np.array(squares(major, minor, angle)))
    np.testing.assert_allclose(found, change, rtol=0, atol=4e-3 * np.abs(change).max())
    # Turned by a right angle it is another one.
    other = effect.added(block, np.array(squares(major, minor, angle + 90)))
    assert np.abs(other - change).max() > 0.1 * np.abs(change).max()


def test_a_round_one_is_as_of_the_effect_of_round_ones() -> None:
    block = small_block(SETUP)
    round_one = ResolvedSource(PLACE).added(block, np.array([400.0]))
    np.testing.assert_allclose(ElongatedSource(PLACE).added(block, np.array([400.0, 0.0, 0.0])), round_one, rtol=1e-12)


def test_axes_and_position_angle_are_told() -> None:
    x = np.array([[*squares(20.0, 8.0, 40.0)]])
    told = ElongatedSource(PLACE).told(SETUP, x, np.full((1, 3), 4.0))
    np.testing.assert_allclose(told.values, [[20.0, 8.0, 40.0]])
    assert [name.rsplit(": ", 1)[1] for name in told.names] == [
        "major axis (FWHM)", "minor axis (FWHM)", "position angle"
    ]  # fmt: skip
    assert told.units == ("arcmin", "arcmin", "deg")
    # d(major^2) = dm + dr, and of r = 168 an error of 4 across it turns it by 4 / 168 of a radian, twice the angle.
    np.testing.assert_allclose(told.std[0, :2], [4 * np.sqrt(2) / 40, 4 * np.sqrt(2) / 16])
    np.testing.assert_allclose(told.std[0, 2], np.rad2deg(0.5 * 4 / 168))
    of_point = ElongatedSource(PLACE).told(SETUP, np.zeros((1, 3)), np.ones((1, 3)))
    assert np.all(np.isfinite(of_point.values))
    assert np.all(np.isfinite(of_point.std))


def test_what_is_narrower_than_a_point_along_an_axis_is_refused() -> None:
    effect, std = ElongatedSource(PLACE), np.full((1, 3), 2.0)
    assert not effect.beyond(SETUP, np.array([[100.0, 60.0, 80.0]]), std).any()
    beyond = effect.beyond(SETUP, np.array([[100.0, 90.0, 120.0]]), std)
    np.testing.assert_allclose(beyond, np.full(3, 50 / np.sqrt(12)))


def test_sources_whose_shape_may_be_round_are_told() -> None:
    """Together; of those whose axes differ by many standard errors, or that are not in the model, nothing is said."""
    places = [PLACE[0], *np.rad2deg([[SETUP.sky.ra[i], SETUP.sky.dec[i]] for i in (1, 2, 3)]).tolist()]
    x = np.array([[*squares(20.0, 8.0, 40.0), *squares(20.0, 19.9, 10.0), 0.0, 0.0, 0.0, *squares(30.0, 30.1, 10.0)]])
    std = np.array([[4.0] * 6 + [0.0] * 3 + [4.0] * 3])
    ((which, effect, widths),) = ElongatedSource(places, 100).simpler_elements(SETUP, x, std)
    assert which.tolist() == [False] * 3 + [True] * 3 + [False] * 3 + [True] * 3
    assert type(effect) is ResolvedSource
    assert effect.sources == tuple(map(tuple, (places[1], places[3])))
    assert effect.trials == 100
    np.testing.assert_array_equal(widths, x[0, [3, 9]])
    assert ElongatedSource(places, 100).simpler_elements(SETUP, x, np.full((1, 12), 1e-3)) == []
