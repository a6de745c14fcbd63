from __future__ import annotations

import numpy as np
import pytest
from numpy.polynomial.hermite_e import hermegauss

from hydrabeam_mpi.effects.shared.point_sources import responses
from hydrabeam_mpi.effects.sky.elongated_source import ElongatedSource
from hydrabeam_mpi.effects.sky.resolved_source import ResolvedSource
from tests.effects.small import small_block, small_setup

SETUP = small_setup((131e6,), n_times=3)


def of(index: list[int]) -> ResolvedSource:
    return ResolvedSource(np.rad2deg([SETUP.sky.ra[index], SETUP.sky.dec[index]]).T.tolist())


@pytest.mark.parametrize(("fwhm", "error"), [(0.1, 1e-4), (0.5, 4e-3), (1.0, 1.5e-2)])
def test_it_is_many_points_about_its_place(fwhm: float, error: float) -> None:
    """On a grid by which a Gaussian is integrated, each point with its own beam and fringes.

    What the beam has beyond its curvature counts the more the wider the source.
    """
    block, index, (nodes, weights) = small_block(SETUP), 4, hermegauss(15)
    ra, dec = SETUP.sky.ra[index], SETUP.sky.dec[index]
    offsets = np.deg2rad(fwhm) / np.sqrt(8 * np.log(2)) * nodes
    east = np.array([-np.sin(ra), np.cos(ra), 0.0])
    north = np.array([-np.sin(dec) * np.cos(ra), -np.sin(dec) * np.sin(ra), np.cos(dec)])
    points = np.cross(east, north) + offsets[:, np.newaxis, np.newaxis] * east + offsets[:, np.newaxis] * north
    x, y, z = points.reshape(-1, 3).T
    share = np.outer(weights, weights).ravel() / weights.sum() ** 2
    wide = responses(block, np.arctan2(y, x), np.arcsin(z / np.hypot(np.hypot(x, y), z))) @ share
    change = SETUP.sky.flux[0, index] * block.spread(wide - responses(block, np.array([ra]), np.array([dec]))[..., 0])
    assert np.abs(change).max() > 0.01 * fwhm**2 * np.abs(block.vis).max()
    found = of([index]).added(block, np.array([(60 * fwhm) ** 2]))
    np.testing.assert_allclose(found, change, rtol=0, atol=error * np.abs(change).max())


def test_a_width_is_told_and_its_square_is_not_below_zero() -> None:
    effect = of([4, 7])
    told = effect.told(SETUP, np.array([[900.0, -4.0]]), np.array([[60.0, 9.0]]))
    np.testing.assert_allclose(told.values, [[30.0, 0.0]])
    np.testing.assert_allclose(told.std, [[1.0, 3.0]])
    assert told.units == ("arcmin", "arcmin")
    assert told.names[0].endswith(": width (FWHM)")
    np.testing.assert_allclose(effect.beyond(SETUP, np.array([[900.0, -27.0]]), np.array([[60.0, 9.0]])), [0, 3])


def test_a_fit_may_begin_anywhere() -> None:
    with np.errstate(over="raise"):
        assert np.all(np.isfinite(of([4]).added(small_block(SETUP), np.array([-1e12]))))


def test_sources_that_are_wide_in_the_model_are_not_looked_for_again() -> None:
    effect = ResolvedSource()
    for newest in (of([4, 7]), ElongatedSource(of([4, 7]).sources)):
        following = effect.next_after(SETUP, newest)
        assert isinstance(following, ResolvedSource)
        assert following.n_hypotheses(SETUP) == effect.n_hypotheses(SETUP) - 2
        assert not {4, 7} & set(following.brightest(SETUP).tolist())
        again = following.next_after(SETUP, of([1]))
        assert isinstance(again, ResolvedSource)
        assert not {1, 4, 7} & set(again.brightest(SETUP).tolist())
        block = small_block(SETUP)
        assert again.scan(block)[0].shape == (again.n_hypotheses(SETUP), 1)
