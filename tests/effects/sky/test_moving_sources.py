from dataclasses import replace

import numpy as np
import pytest

from hydrabeam_mpi.effects.registry import make_effect
from hydrabeam_mpi.effects.sky.missing_sources import MissingSources, candidates
from hydrabeam_mpi.effects.sky.moving_sources import MovingSources
from hydrabeam_mpi.model.sky import Sky, concatenate
from tests.effects.small import check_derivative, small_block, small_setup

HOURS = 24.0


def one_source(freqs: tuple[float, ...] = (131e6, 151e6), n_times: int = 8) -> MovingSources:
    setup = small_setup(freqs, n_times=n_times)
    ra, dec = candidates(setup, np.deg2rad(70.0))
    return MovingSources(np.rad2deg([[ra[3], dec[3]]]).tolist()).in_full(setup)


def test_equals_at_each_time_a_sky_with_the_source_where_it_is() -> None:
    """Its place is that in the middle of the times; it moves on a line in the tangent plane."""
    setup, effect = small_setup(n_times=8), one_source()
    x = np.array([12.0, 0.4, -0.3, 1.5, -2.5, 0.25])
    stays = MissingSources(effect.sources)
    times = setup.observation.times
    hours = HOURS * (times - 0.5 * (times[0] + times[-1]))
    assert np.ptp(hours) > 0.1
    for channel in (0, 1):
        block = small_block(setup, channel)
        added = effect.added(block, x)
        for t, hour in enumerate(hours):
            now = np.array([12.0, 0.4 + 1.5 * hour, -0.3 - 2.5 * hour, 0.25])
            expected = stays.added(block, now)[t]
            np.testing.assert_allclose(added[t], expected, rtol=0, atol=1e-12 * np.abs(expected).max())
            za, az, flux = effect.extra_sky(block, t, x)
            for one, two in zip((za, az, flux), stays.extra_sky(block, t, now), strict=True):
                np.testing.assert_allclose(one, two, rtol=1e-12)
        ra, dec = stays._places(np.array([[12.0, 0.4 + 1.5 * hours[2], -0.3 - 2.5 * hours[2], 0.25]]))
        fluxes = 12.0 * (setup.observation.freqs / setup.reference_freq) ** (-0.7 + 0.25)
        with_it = small_block(setup, channel, sky=concatenate([setup.sky, Sky(ra, dec, fluxes[:, np.newaxis])]))
        np.testing.assert_allclose(added[2], (with_it.vis - block.vis)[2], rtol=0, atol=1e-9 * np.abs(added).max())


@pytest.mark.parametrize("freqs", [(131e6,), (131e6, 151e6)])
def test_derivatives(freqs: tuple[float, ...]) -> None:
    setup, effect = small_setup(freqs, n_times=8), one_source(freqs)
    x = np.array([12.0, 0.4, -0.3, 1.5, -2.5, 0.25])[: 5 + (len(freqs) > 1)]
    check_derivative(effect, small_block(setup), x)
    names = effect.parameters(setup).names
    assert [name.split(": ")[1] for name in names[:5]] == [
        "flux",
        "offset east",
        "offset north",
        "motion east",
        "motion north",
    ]
    # Standing still it is a missing source, of which there are fewer.
    still = x.copy()
    still[3:5] = 0.0
    stays = MissingSources(effect.sources)
    np.testing.assert_allclose(
        effect.added(small_block(setup), still), stays.added(small_block(setup), np.delete(still, [3, 4])), rtol=1e-12
    )
    hypotheses = np.arange(5)
    assert effect.at(setup, hypotheses).trials == 9 * stays.at(setup, hypotheses).trials


def test_told_and_described_from_where_it_is() -> None:
    setup, effect = small_setup(n_times=8), one_source()
    block = small_block(setup)
    x, std = np.tile([12.0, 0.4, -0.3, 0.2, -0.3, 0.25], (2, 1)), np.tile([0.1, 0.02, 0.03, 0.04, 0.05, 0.01], (2, 1))
    refined, left, _ = effect.refined(x, np.arange(6))
    assert isinstance(refined, MovingSources)
    assert refined.span == effect.span
    assert not left[:, 1:3].any()
    expected = effect.added(block, x[0])
    # Along a great circle, but not quite as fast everywhere: by the square of the angles.
    np.testing.assert_allclose(refined.added(block, left[0]), expected, atol=3e-4 * np.abs(expected).max())
    assert not left[:, 3:5].any()
    np.testing.assert_allclose(refined.rates, [[0.2, -0.3]], atol=0.01)
    told = effect.told(setup, x, std)
    (ra, dec), *_ = refined.sources
    np.testing.assert_allclose(told.values[0], [12.0, ra, dec, *refined.rates[0], -0.45])
    np.testing.assert_allclose(told.std[0], [0.1, 0.02 / np.cos(np.deg2rad(dec)), 0.03, 0.04, 0.05, 0.01])
    assert told.units == ("Jy", "deg", "deg", "deg/h", "deg/h", "")
    assert told.names[3].endswith(": motion east")


def test_it_is_known_where_it_is_in_data_of_the_same_time_alone() -> None:
    """And among fewer times it moves as it did among all."""
    setup, effect = small_setup(n_times=8), one_source()
    fewer = replace(setup, times=setup.times[2:5])
    assert effect.carried_over(fewer) is effect
    x = np.array([12.0, 0.4, -0.3, 1.5, -2.5, 0.25])
    np.testing.assert_allclose(effect.added(small_block(fewer), x), effect.added(small_block(setup), x), rtol=1e-12)
    later = replace(setup, observation=replace(setup.observation, times=setup.observation.times + 1.0))
    assert "it moves against the stars" in str(effect.carried_over(later))
    assert isinstance(make_effect("moving_sources", effect.describe()), MovingSources)
    assert make_effect("moving_sources", effect.describe()).describe() == effect.describe()
