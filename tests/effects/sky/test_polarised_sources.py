from collections import Counter
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

from hydrabeam_mpi.data.observation import C_M_PER_S
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.registry import make_effect
from hydrabeam_mpi.effects.sky.polarised_sources import (
    Mount,
    PolarisedSources,
    rotation_grid,
    rotation_step,
    twice_angle,
)
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.loop.attribution.scan import brightest_first
from hydrabeam_mpi.model.engines.fringes import enu
from hydrabeam_mpi.random import complex_normal, generator
from tests.effects.small import small_block, small_setup

BAND = tuple(140e6 + 1e6 * np.arange(8.0))


def pinned(setup: ObservingSetup, index: list[int], *rotation: float) -> PolarisedSources:
    sky = setup.sky
    return PolarisedSources(np.rad2deg([sky.ra[index], sky.dec[index]]).T.tolist(), 1, rotation)


@pytest.mark.parametrize(("pol", "seen"), [("ee", -1.0), ("nn", 1.0), ("xx", -1.0), ("yy", 1.0)])
def test_towards_the_zenith_and_along_the_meridian(pol: str, seen: float) -> None:
    """A dipole towards North receives Q and one towards East minus Q, and neither has any U."""
    setup = small_setup()
    setup = replace(setup, observation=replace(setup.observation, pols=(pol,)))
    za, az = np.deg2rad([0.0, 1.0, 20.0, 20.0]), np.deg2rad([0.0, 200.0, 90.0, 270.0])
    np.testing.assert_allclose(twice_angle(setup, enu(za, az)), seen, rtol=0, atol=0.06)
    np.testing.assert_allclose(twice_angle(setup, enu(za[[0, 2, 3]], az[[0, 2, 3]])), seen, rtol=0, atol=1e-12)


def test_the_rotation_measure_turns_it_over_the_band() -> None:
    """As Q + iU of the frequency to which these refer, times exp(2 i RM (lambda^2 - lambda_0^2))."""
    setup = small_setup((110e6, 131e6, 150e6), n_times=2)
    x, rotation = np.array([0.2, 0.1, 1.5]), 12.0
    block = small_block(setup, 0)
    source = int(block.sources(0).index[7])
    effect = replace_freq(pinned(setup, [source], rotation), 120e6)
    for channel, freq in enumerate(setup.observation.freqs):
        sources = small_block(setup, channel).sources(0)
        turned = (0.2 + 0.1j) * np.exp(2j * 13.5 * ((C_M_PER_S / freq) ** 2 - (C_M_PER_S / 120e6) ** 2))
        simple = replace_freq(pinned(setup, [source]), float(freq))
        expected = simple.sky_factor(setup, sources, np.array([turned.real, turned.imag, 0.0]))
        np.testing.assert_allclose(effect.sky_factor(setup, sources, x), expected, rtol=1e-12)
        assert np.count_nonzero(np.abs(expected - 1) > 1e-6) == 1


def replace_freq(effect: PolarisedSources, freq: float) -> PolarisedSources:
    return PolarisedSources(effect.sources, effect.trials, effect.rotation_measures, effect.mounts, freq)


def test_on_an_alt_az_mount_the_feeds_turn_with_the_parallactic_angle() -> None:
    """tan q = sin H / (tan(latitude) cos(dec) - sin(dec) cos H), of the vertical; the other feed is across."""
    setup = small_setup()
    latitude, ra, dec = setup.observation.latitude, setup.sky.ra, setup.sky.dec
    block = small_block(setup, 0)
    index, za, az = block.positions.above_horizon(2)
    angle = setup.observation.lsts[2] - ra[index]
    below = np.tan(latitude) * np.cos(dec[index]) - np.sin(dec[index]) * np.cos(angle)
    q = np.arctan2(np.sin(angle) * np.cos(latitude), below * np.cos(latitude))
    east = replace(setup, observation=replace(setup.observation, pols=("nn",)))
    np.testing.assert_allclose(twice_angle(east, enu(za, az), "alt-az"), np.exp(2j * q), rtol=0, atol=1e-9)
    np.testing.assert_allclose(twice_angle(setup, enu(za, az), "alt-az"), -np.exp(2j * q), rtol=0, atol=1e-9)


@pytest.mark.parametrize("mount", get_args(Mount))
def test_scan_finds_source_rotation_measure_and_mount(mount: Mount) -> None:
    setup = small_setup(BAND, n_times=8)
    grid = rotation_grid(setup)
    truth = PolarisedSources(PolarisedSources().foremost(setup, 1).sources, 1, [float(grid[-3])], [mount])
    effect, sums = PolarisedSources(), np.zeros((2, PolarisedSources().n_hypotheses(setup), 2))
    for channel in range(len(BAND)):
        block = small_block(setup, channel)
        noise = 1e-3 * np.abs(block.vis).max() * complex_normal(generator(1, "noise", str(channel)), block.shape)
        sums += effect.scan(replace(block, residual=truth.added(block, np.array([0.1, -0.3, 0.0])) + noise))
    drop = np.sum(sums[0] ** 2 / np.maximum(sums[1], 1e-9 * sums[1].max()), axis=1)
    found = effect.at(setup, np.argsort(-drop))
    np.testing.assert_allclose(found.sources[0], truth.sources[0], rtol=0, atol=1e-10)
    # Its sign is told by how the angle turns, and columns of a scan are taken as orthogonal.
    np.testing.assert_allclose(np.abs(found.rotation_measures[0]), grid[-3], rtol=1e-12)
    assert found.mounts[0] == mount
    assert len(found.sources) == 40
    assert max(Counter(found.sources).values()) <= 6
    own = np.sort(
        [of for place, of in zip(found.sources, found.rotation_measures, strict=True) if place == found.sources[0]]
    )
    assert np.all(np.diff(own) > 1.5 * rotation_step(setup))
    assert found.parameters(setup).trials == 60 * len(grid) * 2


def test_each_source_is_looked_at_again_with_its_best_rotation_measure_first() -> None:
    """Of the brightest, which have as much power with any, and not all rotation measures of one of them."""
    setup = small_setup(BAND, n_times=4)
    effect = PolarisedSources()
    same, rng = effect.of_the_same(setup), generator(3, "scan")
    power = np.repeat(rng.uniform(1, 2, 60), len(same) // 60)
    drop = rng.uniform(0, 1, len(same))
    found = brightest_first(drop, power, same)
    assert len(found) == 60
    assert np.all(np.diff(power[found]) <= 0)
    np.testing.assert_array_equal(same[found], np.argsort(-power[:: len(same) // 60]))
    best = [drop[same == source].max() for source in same[found]]
    np.testing.assert_array_equal(drop[found], best)


def test_rotation_measures_that_channels_tell_from_each_other() -> None:
    """Two channels tell none apart that turn by half a turn more from one to the other, and one channel none at all."""
    two, one = small_setup((131e6, 151e6)), small_setup((131e6,))
    apart = float(-np.diff((C_M_PER_S / np.array([131e6, 151e6])) ** 2)[0])
    np.testing.assert_allclose(rotation_grid(two), np.array([-1, 0, 1]) / apart)
    np.testing.assert_array_equal(rotation_grid(one), [0.0])
    assert rotation_step(one) == 0.0
    assert pinned(one, [0]).parameters(one).names[1].endswith(": U/I")
    assert len(pinned(one, [0]).parameters(one)) == 2
    grid = rotation_grid(small_setup(BAND))
    assert 100 - np.diff(grid)[0] < grid.max() <= 100


def test_refined_and_told() -> None:
    setup = small_setup()
    effect = pinned(setup, [3, 5, 9], 1.0, 2.0, 3.0)
    x = np.arange(18.0).reshape(2, 9) / 10
    x[1, 2::3] = x[0, 2::3]
    kept, values, left = effect.refined(x, np.array([3, 4, 5, 8]))
    assert kept.sources == effect.sources[1:]
    np.testing.assert_allclose(kept.rotation_measures, [2.5, 3.8])
    np.testing.assert_array_equal(left, np.arange(3, 9))
    np.testing.assert_array_equal(values, np.where(np.arange(6) % 3 == 2, 0.0, x[:, 3:]))
    told = effect.told(setup, x, np.ones_like(x))
    assert told.names[5].endswith(": rotation measure")
    assert told.units[3:6] == ("", "", "rad/m^2")
    np.testing.assert_allclose(told.values[0], [0, 0.1, 1.2, 0.3, 0.4, 2.5, 0.6, 0.7, 3.8])
    np.testing.assert_array_equal(told.from_zero, np.arange(9) % 3 < 2)
    assert make_effect(kept.kind, kept.describe()).describe() == kept.describe()
    full = kept.in_full(setup)
    assert full.freq == 141e6
    assert full.in_full(small_setup(BAND)).freq == 141e6


def test_none_is_polarised_by_more_than_all_of_its_flux() -> None:
    setup = small_setup((131e6,))
    effect = pinned(setup, [3, 5])
    x, std = np.array([[0.6, -0.8, 3.0, 4.0]]), np.full((1, 4), 0.1)
    np.testing.assert_allclose(effect.beyond(setup, x, std), [0, 0, 4 / np.hypot(0.1, 0.1), 4 / np.hypot(0.1, 0.1)])
    assert effect.without(effect.beyond(setup, x, std) > 0)[0].sources == effect.sources[:1]


def test_a_rotation_measure_for_each_source() -> None:
    with pytest.raises(InputError, match="not understood"):
        make_effect("polarised_sources", {"sources": [[1.0, 2.0]], "rotation_measures": [1.0, 2.0]})


def test_other_data_know_the_sources_that_they_have() -> None:
    setup = small_setup()
    effect = PolarisedSources([(12.0, -80.0), *pinned(setup, [4]).sources], 1, [5.0, -7.0], ["alt-az", "fixed"], 131e6)
    here = effect.carried_over(setup)
    assert here.describe() == {**pinned(setup, [4], -7.0).describe(), "freq": 131e6}
