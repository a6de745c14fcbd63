"""Baselines that stand out from all others are found, by themselves or as those of an antenna, and no others."""

from __future__ import annotations

import numpy as np
import pytest

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.reweighting import ReweightingFit
from hydrabeam_mpi.effects.noise.bad_baselines import BadBaselines
from hydrabeam_mpi.random import complex_normal, generator
from tests.effects.small import small_block, small_setup

SETUP = small_setup(n_times=40)
BLOCK = small_block(SETUP)
HELD: IntArray = np.arange(1, 40, 2)
ENDS = SETUP.observation.antenna_index
N_BLS = SETUP.observation.Nbls


def whitened(seed: int, scales: dict[int, float] | None = None) -> ComplexArray:
    """Return noise, larger by ``scales`` on some baselines."""
    z = complex_normal(generator(seed, "noise"), BLOCK.shape)
    for bl, larger in (scales or {}).items():
        z[:, bl] *= larger
    return z


def fit(z: ComplexArray, unseen: IntArray | None = None) -> ReweightingFit:
    """Weigh the first channel, of which every second time is held out, and ``unseen`` baselines; the other is empty."""
    change = BadBaselines()
    sums = np.zeros((2, change.n_sums(SETUP)))
    fitted = np.where(np.isin(np.arange(40), HELD)[:, np.newaxis], 0, z)
    if unseen is not None:
        fitted[:, unseen] = 0
    sums[0] = change.sums(BLOCK, fitted) + change.heldout_sums(SETUP, HELD, BLOCK.bls, z[HELD])
    return change.fit(SETUP, sums, np.zeros(2))


def bad(found: ReweightingFit) -> IntArray:
    assert np.all(found.x[1] == 1)
    return np.flatnonzero(found.x[0] > 1)


def of_antenna(ant: int) -> IntArray:
    return np.flatnonzero((ant == ENDS).any(axis=1))


def test_noise_has_none() -> None:
    for seed in range(200):
        found = fit(whitened(seed))
        assert found.log_bayes_factor == 0
        assert not len(bad(found))


def test_their_scales() -> None:
    pulls, truth = [], {2: 5.0, 11: 1000.0}
    for seed in range(20):
        found = fit(whitened(seed, truth))
        np.testing.assert_array_equal(bad(found), [2, 11])
        pulls.append((found.x[0, [2, 11]] - list(truth.values())) / found.std[0, [2, 11]])
    assert 0.6 < np.std(pulls) < 1.4
    assert abs(np.mean(pulls)) < 0.5


def test_one_that_is_held_out() -> None:
    unseen: IntArray = np.array([7])
    np.testing.assert_array_equal(bad(fit(whitened(1, {7: 20.0}), unseen)), [7])


@pytest.mark.parametrize("scale", [3.0, 100.0])
def test_all_of_an_antenna(scale: float) -> None:
    """However large they are, with those of the others as they should be."""
    mine = of_antenna(3)
    found = fit(whitened(2, dict.fromkeys(mine.tolist(), scale)))
    np.testing.assert_array_equal(bad(found), mine)
    assert found.log_bayes_factor > 100


def test_an_antenna_with_more_than_a_quarter_of_all_baselines_and_one_of_others() -> None:
    mine = of_antenna(3)
    assert len(mine) > 0.25 * N_BLS
    both = np.sort([*mine, np.setdiff1d(np.arange(N_BLS), mine)[4]])
    found = fit(whitened(3, dict.fromkeys(both.tolist(), 30.0)))
    np.testing.assert_array_equal(bad(found), both)
    assert found.reason is None


def test_one_wild_baseline_makes_no_antenna_bad() -> None:
    for seed in range(20):
        np.testing.assert_array_equal(bad(fit(whitened(seed, {5: 1e4}))), [5])


def test_what_redundant_baselines_have_in_common_is_in_the_sky() -> None:
    group = SETUP.redundant.group
    whole = np.flatnonzero(group == np.bincount(group).argmax())
    assert 3 <= len(whole) <= 0.25 * N_BLS
    assert not len(bad(fit(whitened(6, dict.fromkeys(whole.tolist(), 20.0)))))
    np.testing.assert_array_equal(bad(fit(whitened(6, {int(whole[0]): 20.0}))), whole[:1])


def test_what_many_have_is_not_bad() -> None:
    many = generator(1, "many").choice(N_BLS, int(0.4 * N_BLS), replace=False)
    found = fit(whitened(5, dict.fromkeys(many.tolist(), 20.0)))
    assert found.log_bayes_factor <= 0
    assert found.reason == "more than 25% of the baselines stand out, which are not a few"


def test_an_effect_that_explains_them_gains_more() -> None:
    """As it leaves noise."""
    z = whitened(4, {4: 3.0, 9: 3.0})
    found = fit(z)
    explained = sum(float(np.sum(np.abs(z[:, bl]) ** 2)) - BLOCK.shape[0] for bl in (4, 9))
    assert 0 < found.log_bayes_factor < 0.9 * explained


def test_what_is_left_out_and_what_it_costs() -> None:
    change, x = BadBaselines(), np.ones(N_BLS)
    x[[2, 11]] = 3.0
    factor = change.weight_factor(BLOCK, x)
    expected: FloatArray = np.ones(BLOCK.shape)
    expected[:, [2, 11]] = 0.0
    np.testing.assert_array_equal(factor, expected)
    price = change.price(SETUP, 0, np.array([4, 6]), np.array([1, 2]), x)
    np.testing.assert_allclose(price, [[np.inf, 1 + np.log(9)]] * 2)
