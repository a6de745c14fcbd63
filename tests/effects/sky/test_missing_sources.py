from dataclasses import replace

import numpy as np
import pytest

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.shared.point_sources import resolution
from hydrabeam_mpi.effects.sky.missing_sources import MissingSources, brightest_expected, candidates
from hydrabeam_mpi.model.positions import ApparentPositions
from hydrabeam_mpi.model.sky import Sky, separation
from hydrabeam_mpi.random import generator
from tests.effects.small import check_adds_sources, check_derivative, small_block, small_setup


def two_sources(setup: ObservingSetup) -> MissingSources:
    ra, dec = candidates(setup, np.deg2rad(70.0))
    return MissingSources(np.rad2deg([[ra[3], dec[3]], [ra[-3], dec[-3]]]).tolist())


def test_equals_a_sky_with_the_source_in_it() -> None:
    """At both frequencies, by the offset's meaning on the sphere: east along increasing right ascension."""
    setup = small_setup()
    effect = two_sources(setup)
    flux, east, north, change = 12.0, 0.4, -0.3, 0.25
    x = np.array([flux, east, north, change, 0, 0, 0, 0])
    ra, dec = np.deg2rad(effect.sources[0])
    offset = np.hypot(east, north)
    # Great circle at a position angle from north through east; tangent-plane radii are tangents.
    angle, towards = np.arctan(np.deg2rad(offset)), np.arctan2(east, north)
    moved_dec = np.arcsin(np.sin(dec) * np.cos(angle) + np.cos(dec) * np.sin(angle) * np.cos(towards))
    moved_ra = ra + np.arctan2(
        np.sin(towards) * np.sin(angle) * np.cos(dec), np.cos(angle) - np.sin(dec) * np.sin(moved_dec)
    )
    fluxes = flux * (setup.observation.freqs / setup.reference_freq) ** (-0.7 + change)
    check_adds_sources(effect, setup, x, Sky(np.array([moved_ra]), np.array([moved_dec]), fluxes[:, np.newaxis]))


def test_follows_the_rule_of_the_sky() -> None:
    setup = small_setup()
    block = small_block(setup)
    block = replace(block, positions=ApparentPositions(setup.sky, setup.observation))
    effect = two_sources(setup)
    x = np.array([10.0, 0.1, 0.2, 0.0, 0, 0, 0, 0])
    ra, dec = effect._places(x.reshape(2, 4))
    flux = 10.0 * (block.freq / setup.reference_freq) ** -0.7
    sky = Sky(ra[:1], dec[:1], np.full((2, 1), flux))
    positions = ApparentPositions(sky, setup.observation)
    alone = replace(block, setup=replace(setup, sky=sky), positions=positions)
    expected = block.spread(alone.integrate(lambda sources: sources.beam[np.newaxis])[..., 0])
    np.testing.assert_allclose(effect.added(block, x), expected, rtol=0, atol=1e-12 * np.abs(expected).max())
    check_derivative(effect, block, x)


def found(setup: ObservingSetup, residual_of: MissingSources, x: FloatArray) -> MissingSources:
    effect = MissingSources()
    totals = [np.zeros((effect.n_hypotheses(setup), 1)) for _ in range(2)]
    for channel in range(setup.observation.Nfreqs):
        block = small_block(setup, channel)
        block = replace(block, residual=residual_of.added(block, x))
        for total, part in zip(totals, effect.scan(block), strict=True):
            total += part
    projection, power = totals
    score = np.maximum(projection, 0)[:, 0] ** 2 / np.maximum(power[:, 0], 1e-9 * power.max())
    return effect.at(setup, np.argsort(-score))


def test_scan_finds_a_source_between_grid_points() -> None:
    setup = small_setup()
    truth = MissingSources().drawn(setup, generator(6, "pick"))
    x = truth.draw(setup, generator(7, "draw"), 5.0)
    effect = found(setup, truth, x)
    (found_ra, found_dec), (ra, dec) = np.deg2rad(effect.sources[0]), truth._places(x.reshape(1, 4))
    assert separation(found_ra, found_dec, ra, dec) < 0.35 * resolution(setup)
    ra, dec = np.deg2rad(effect.sources).T
    assert len(ra) == 20
    assert effect.trials >= 10
    apart = separation(ra[:, np.newaxis], dec[:, np.newaxis], ra, dec)[np.triu_indices(20, 1)]
    assert apart.min() > resolution(setup)


def test_candidates_are_the_points_that_rise() -> None:
    setup = small_setup()
    ra, dec = candidates(setup)
    observation = setup.observation
    lat = float(observation.location.lat.rad)
    lsts = observation.lsts[:, np.newaxis]
    za = separation(ra, dec, lsts, lat)
    assert za.min(axis=0).max() <= np.deg2rad(85.0)
    # What is missing is what does not rise: the sky that does rise is covered evenly.
    rng = generator(8, "sky")
    any_ra, any_dec = rng.uniform(0, 2 * np.pi, 500), np.arcsin(rng.uniform(-1, 1, 500))
    up = separation(any_ra, any_dec, lsts, lat).min(axis=0) < np.deg2rad(80)
    nearest = separation(ra, dec, any_ra[up, np.newaxis], any_dec[up, np.newaxis]).min(axis=1)
    assert nearest.max() < 0.35 * resolution(setup)


@pytest.mark.parametrize(("freqs", "each"), [((131e6,), 3), ((131e6, 151e6), 4)])
def test_one_channel_has_no_spectral_index(freqs: tuple[float, ...], each: int) -> None:
    setup = small_setup(freqs)
    effect = two_sources(setup)
    parameters = effect.parameters(setup)
    assert parameters.element.tolist() == [0] * each + [1] * each
    assert parameters.nonlinear.tolist() == ([False] + [True] * (each - 1)) * 2
    check_derivative(effect, small_block(setup), effect.draw(setup, generator(1, "missing"), 20.0))


def test_described_from_where_they_are_they_are_the_same() -> None:
    """And told by right ascension and declination, with the errors that offsets have on the sky."""
    setup = small_setup()
    block, effect = small_block(setup), two_sources(setup)
    x = np.tile([12.0, 0.4, -0.3, 0.25, 3.0, 0.0, 0.1, 0.0], (2, 1))
    std = np.tile([0.1, 0.02, 0.03, 0.01, 0.2, 0.04, 0.05, 0.02], (2, 1))
    refined, left, _ = effect.refined(x, np.arange(8))
    expected = effect.added(block, x[0])
    np.testing.assert_allclose(refined.added(block, left[0]), expected, atol=1e-9 * np.abs(expected).max())
    assert not left[:, [1, 2, 5, 6]].any()
    np.testing.assert_allclose(refined.refined(left, np.arange(8))[0].sources, refined.sources, rtol=1e-14)
    only, its, which = effect.refined(x, np.array([4, 5, 6]))
    assert only.sources == refined.sources[1:]
    assert which.tolist() == [4, 5, 6, 7]
    np.testing.assert_array_equal(its, left[:, 4:])
    told = effect.told(setup, x, std)
    again = refined.told(setup, left, std)
    assert told.names == again.names
    np.testing.assert_allclose(told.values, again.values, rtol=1e-12)
    (ra, dec), _ = refined.sources
    assert told.names[:4] == tuple(
        f"source at ra={ra:.3f} dec={dec:.3f}: {what}"
        for what in ("flux", "right ascension", "declination", "spectral index")
    )
    np.testing.assert_allclose(told.values[1, :4], [12.0, ra, dec, -0.45])
    np.testing.assert_allclose(told.std[1, :4], [0.1, 0.02 / np.cos(np.deg2rad(dec)), 0.03, 0.01])
    assert told.from_zero.tolist() == [True, False, False, False] * 2
    assert told.units == ("Jy", "deg", "deg", "") * 2
    nothing, empty, none = MissingSources().refined(np.zeros((2, 0)), np.arange(0))
    assert nothing.sources == ()
    assert empty.shape == (2, 0)
    assert not len(none)


def test_more_than_one_source_is_not_expected_above_the_counts() -> None:
    """By counts that fall as S^-3/2: one of many skies in three has none there, and what is fainter costs nothing."""
    brightest, expected = [], []
    for seed in range(300):
        u = generator(seed, "counts").uniform(size=500)
        sky = Sky(np.zeros(500), np.zeros(500), np.stack([u ** (-2 / 3), 3 * u ** (-2 / 3)]))
        brightest.append(sky.flux.mean(axis=0).max())
        expected.append(brightest_expected(sky))
    assert np.median(expected) == pytest.approx(2 * 500 ** (2 / 3), rel=0.1)
    assert np.mean(np.array(brightest) < 2 * 500 ** (2 / 3)) == pytest.approx(np.exp(-1), abs=0.1)
    setup = small_setup()
    assert two_sources(setup).parameters(setup).rare_above == brightest_expected(setup.sky)
    assert np.isinf(brightest_expected(Sky(np.zeros(0), np.zeros(0), np.zeros((1, 0)))))
