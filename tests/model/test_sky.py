import numpy as np
import pytest
from astropy import units
from astropy.coordinates import SkyCoord
from scipy import stats

from hydrabeam_mpi.model.sky import Sky, concatenate, mock_sky, power_law, separation

FREQS = np.array([100e6, 131e6, 150e6])


def test_mock_sky_has_the_papers_distributions():
    sky = mock_sky(3, FREQS)
    assert sky.flux.shape == (3, 10_000)
    assert stats.kstest(sky.ra, stats.uniform(0, 2 * np.pi).cdf).pvalue > 0.01
    assert stats.kstest(np.sin(sky.dec), stats.uniform(-1, 2).cdf).pvalue > 0.01
    assert stats.kstest(sky.flux[0], stats.loguniform(0.1, 100).cdf).pvalue > 0.01
    # "roughly 33 mJy to 33 Jy at 150 MHz"
    assert 0.033 < sky.flux[2].min() < 0.034
    assert 33 < sky.flux[2].max() < 33.5


def test_mock_sky_depends_on_its_seed_alone():
    np.testing.assert_array_equal(mock_sky(3, FREQS).flux, mock_sky(3, FREQS).flux)
    np.testing.assert_array_equal(mock_sky(3, FREQS).ra, mock_sky(3, FREQS[1:]).ra)
    assert not np.any(mock_sky(4, FREQS).ra == mock_sky(3, FREQS).ra)


def test_incomplete_sky_is_cut_at_the_reference_frequency():
    sky = mock_sky(5, FREQS[1:2])
    bright = sky.brighter_than(1.0)
    at_100_mhz = sky.flux[0] * (100 / 131) ** -2.7
    assert bright.Nsrc == np.sum(at_100_mhz >= 1.0)
    np.testing.assert_array_equal(bright.ra, sky.ra[at_100_mhz >= 1.0])
    # A third of the decades and (1 - 0.1) / (100 - 0.1) of the flux lie below 1 Jy.
    assert bright.Nsrc / sky.Nsrc == pytest.approx(2 / 3, abs=0.015)
    assert 1 - bright.flux.sum() / sky.flux.sum() == pytest.approx(0.009, abs=0.001)


def small_sky():
    return Sky(
        ra=np.array([0.1, 0.2, 6.2]),
        dec=np.array([-0.5, 0.0, 0.5]),
        flux=np.array([[1.0, 2.0, 3.0], [5.0, 4.0, 1.0]]),
        names=("a", "b", "c"),
    )


def test_select_by_mask_and_by_index_keeps_columns_together():
    by_mask = small_sky().select(np.array([True, False, True]))
    by_index = small_sky().select(np.array([0, 2]))
    for sky in by_mask, by_index:
        assert sky.names == ("a", "c")
        np.testing.assert_array_equal(sky.flux, [[1.0, 3.0], [5.0, 1.0]])
        np.testing.assert_array_equal(sky.dec, [-0.5, 0.5])
        assert sky.flux.flags.c_contiguous


def test_brightness_without_reference_is_the_mean_over_channels():
    np.testing.assert_array_equal(small_sky().brightness, [3.0, 3.0, 2.0])
    assert small_sky().brighter_than(2.5).names == ("a", "b")


def test_cut_keeps_the_deep_negative_pixels_of_a_map():
    pixels = Sky(np.zeros(3), np.zeros(3), np.array([[-2.0, 0.5, 2.0]]))
    np.testing.assert_array_equal(pixels.brighter_than(1.0).flux, [[-2.0, 2.0]])
    assert pixels.brighter_than(0.0).Nsrc == 3


def test_channels_keeps_frequencies():
    np.testing.assert_array_equal(small_sky().channels(np.array([1])).flux, [[5.0, 4.0, 1.0]])


def test_separation_across_ra_zero():
    np.testing.assert_allclose(separation([0.1, 6.2], 0.0, 0.0, 0.0), [0.1, 2 * np.pi - 6.2], rtol=1e-12)


def test_concatenate_joins_point_sources_and_unnamed_pixels():
    pixels = Sky(np.zeros(2), np.zeros(2), np.full((2, 2), 0.5))
    joined = concatenate([small_sky(), pixels])
    assert joined.names == ("a", "b", "c", "", "")
    assert joined.flux.shape == (2, 5)
    assert joined.reference_flux is None
    assert concatenate([pixels, pixels]).names is None


def test_columns_of_unequal_length_are_refused():
    with pytest.raises(ValueError, match=r"lengths \[2, 3\]"):
        Sky(np.zeros(3), np.zeros(2), np.ones((1, 3)))


def test_separation_agrees_with_astropy():
    rng = np.random.default_rng(0)
    ra1, ra2 = rng.uniform(0, 2 * np.pi, (2, 100))
    dec1, dec2 = np.arcsin(rng.uniform(-1, 1, (2, 100)))
    expected = SkyCoord(ra1, dec1, unit="rad").separation(SkyCoord(ra2, dec2, unit="rad")).to_value(units.rad)
    np.testing.assert_allclose(separation(ra1, dec1, ra2, dec2), expected, rtol=1e-12)
    assert separation(1.0, 0.5, 1.0, 0.5 + 1e-9) == pytest.approx(1e-9, rel=1e-6)


def test_power_law_is_exact_per_source():
    flux = power_law(np.array([2.0, 3.0]), np.array([180e6, 100e6]), np.array([-0.8, 0.0]), FREQS)
    np.testing.assert_allclose(flux[:, 0], 2.0 * (FREQS / 180e6) ** -0.8, rtol=1e-15)
    np.testing.assert_array_equal(flux[:, 1], 3.0)
