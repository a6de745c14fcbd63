"""Integrations that stand out from all others are found, fitted and held-out ones alike, and no others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.reweighting import ReweightingFit
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.noise.bad_integrations import BadIntegrations
from hydrabeam_mpi.random import complex_normal, generator
from tests.effects.small import small_block, small_setup

EXPERIMENT = small_setup(n_times=40)
BLOCK = small_block(EXPERIMENT)
HELD: IntArray = np.arange(1, 40, 2)
FITTED: IntArray = np.arange(0, 40, 2)
BAD: IntArray = np.array([4, 5, 19])


def whitened(seed: int, scale: dict[int, float] | None = None) -> ComplexArray:
    """Return noise, larger by ``scale`` at some times."""
    z = complex_normal(generator(seed, "noise"), BLOCK.shape)
    for time, larger in (scale or {}).items():
        z[time] *= larger
    return z


def fit(z: ComplexArray) -> ReweightingFit:
    """Weigh the first channel, of which every second time is held out; the other has no data."""
    change, sums = BadIntegrations(), np.zeros((2, BadIntegrations().n_sums(EXPERIMENT)))
    fitted = np.where(np.isin(np.arange(40), FITTED)[:, np.newaxis], z, 0)
    sums[0] = change.sums(BLOCK, fitted) + change.heldout_sums(EXPERIMENT, HELD, BLOCK.bls, z[HELD])
    return change.fit(EXPERIMENT, sums, np.zeros(2))


def test_noise_has_none() -> None:
    for seed in range(200):
        found = fit(whitened(seed))
        assert found.log_bayes_factor == 0
        assert np.all(found.x == 1)


def test_their_scales() -> None:
    pulls = []
    for seed in range(20):
        truth = {4: 5.0, 5: 1000.0, 19: 30.0}
        found = fit(whitened(seed, truth))
        np.testing.assert_array_equal(np.flatnonzero(found.x[0] > 1), BAD)
        assert np.all(found.x[1] == 1)
        pulls.append((found.x[0, BAD] - list(truth.values())) / found.std[0, BAD])
        assert np.all(found.std[0, np.delete(np.arange(40), BAD)] == 0)
    assert 0.7 < np.std(pulls) < 1.3
    assert abs(np.mean(pulls)) < 0.5


def test_the_evidence_is_that_of_the_marginal_likelihood() -> None:
    """Integrated over ln s, with a flat prior, and shared out over all choices of as many integrations."""
    z = whitened(3, {5: 20.0})
    found, n = fit(z), BLOCK.shape[1]
    log_s: FloatArray = np.linspace(np.log(10), np.log(40), 4001)
    power = float(np.sum(np.abs(z[5]) ** 2))
    log_likelihood = power - 2 * n * log_s - power * np.exp(-2 * log_s)
    top = log_likelihood.max()
    integral = np.log(np.sum(np.exp(log_likelihood - top)) * (log_s[1] - log_s[0]) / np.log(1e5))
    assert found.log_bayes_factor == pytest.approx(top + integral - np.log(40), abs=0.01)


@pytest.mark.parametrize("n_freqs", [2, 8])
def test_what_hardly_shows_in_one_channel_shows_in_all(n_freqs: int) -> None:
    """Noise twice as large in all channels; another integration is bad in one of them, and in no other."""
    setup = small_setup(freqs=tuple(131e6 + 1e6 * np.arange(n_freqs)), n_times=40)
    change = BadIntegrations()
    told, alone, elsewhere, false = [], [], [], []
    for seed in range(30):
        rng = generator(seed, "channels")
        z = [complex_normal(rng, BLOCK.shape) for _ in range(n_freqs)]
        for one in z:
            one[19] *= 2.0
        z[0][5] *= 5.0
        sums = np.array(
            [
                change.sums(block_of(setup, channel), np.where(np.isin(np.arange(40), FITTED)[:, np.newaxis], one, 0))
                + change.heldout_sums(setup, HELD, BLOCK.bls, one[HELD])
                for channel, one in enumerate(z)
            ]
        )
        found = change.fit(setup, sums, np.zeros(n_freqs)).x > 1
        told.append(found[:, 19].mean())
        alone.append(found[0, 5])
        elsewhere.append(found[1:, 5].any())
        false.append(found[:, np.delete(np.arange(40), [5, 19])].any())
    assert np.mean(told) > 0.8
    assert all(alone)
    assert not any(elsewhere)
    assert sum(false) <= 1


def block_of(setup: ObservingSetup, channel: int) -> RowBlock:
    return replace(small_block(EXPERIMENT), setup=setup, channel=channel)


def test_an_effect_that_explains_them_gains_more() -> None:
    """As it leaves noise."""
    z = whitened(4, {4: 3.0, 19: 3.0})
    found = fit(z)
    explained = sum(float(np.sum(np.abs(z[time]) ** 2)) - BLOCK.shape[1] for time in (4, 19))
    assert 0 < found.log_bayes_factor < 0.8 * explained


@pytest.mark.parametrize("share", [0.2, 0.4])
def test_what_many_have_is_not_bad(share: float) -> None:
    many = generator(1, "many").choice(40, int(share * 40), replace=False)
    found = fit(whitened(5, dict.fromkeys(many.tolist(), 20.0)))
    if share == 0.2:
        assert np.count_nonzero(found.x[0] > 1) == 8
        assert found.log_bayes_factor > 1000
    else:
        assert found.log_bayes_factor <= 0
        assert found.reason == "more than 25% of the integrations stand out, which are not a few"


def test_beside_residuals_that_are_larger_than_noise() -> None:
    """What all have in common does not make them bad, and does not hide those that are."""
    found = fit(10 * whitened(6, {5: 30.0}))
    np.testing.assert_array_equal(np.flatnonzero(found.x[0] > 1), [5])


def test_what_is_left_out_and_what_it_costs() -> None:
    change, x = BadIntegrations(), np.ones(40)
    x[BAD] = 3.0
    factor = change.weight_factor(BLOCK, x)
    np.testing.assert_array_equal(np.flatnonzero(np.all(factor == 0, axis=1)), BAD)
    assert np.all(np.delete(factor, BAD, axis=0) == 1)
    price = change.price(EXPERIMENT, 0, np.array([4, 6]), BLOCK.bls, x)
    # Minus the mean of ln[exp(-|z|^2 / s^2) / s^2] where E|z|^2 = s^2.
    np.testing.assert_allclose(price[0], 1 + np.log(9))
    assert np.all(np.isinf(price[1]))
