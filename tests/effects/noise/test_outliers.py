"""Few bursts are found and left out; what is not few, or lasts, or follows the model, is refused."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from hydrabeam_mpi.effects.interface.reweighting import ReweightingFit
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.noise.heavy_tail import log_broad
from hydrabeam_mpi.effects.noise.outliers import Outliers
from hydrabeam_mpi.effects.registry import make_reweighting
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.random import complex_normal, generator
from tests.effects.small import small_block, small_setup

EXPERIMENT = small_setup(n_times=60)
BURSTS = np.array([15.0, 0.01, 1000.0])


def row_blocks(*key: int | str, scale: float = 1.0) -> list[RowBlock]:
    """Both channels with noise of a hundredth of the largest visibility, some rows without weight."""
    made = []
    for channel in range(2):
        block = small_block(EXPERIMENT, channel)
        sigma = 0.01 * np.abs(block.vis).max()
        rng = generator(1, "noise", channel, *key)
        block.residual[:] = scale * sigma * complex_normal(rng, block.shape)
        block.weights[:] = np.where(rng.random(block.shape) < 0.1, 0.0, sigma**-2)
        made.append(block)
    return made


def fit(made: list[RowBlock], effect: Outliers | None = None) -> ReweightingFit:
    effect = effect or Outliers()
    sums = np.array([effect.sums(block, block.residual * np.sqrt(block.weights)) for block in made])
    assert sums.shape == (2, effect.n_sums(EXPERIMENT))
    return effect.fit(EXPERIMENT, sums, np.zeros(2))


def with_bursts(made: list[RowBlock], *key: int | str) -> list[RowBlock]:
    return [
        replace(one, residual=Outliers().inject(one.residual, one, BURSTS, generator(2, "bursts", f, *key)))
        for f, one in enumerate(made)
    ]


def test_noise_has_no_outliers() -> None:
    assert max(fit(row_blocks(seed)).log_bayes_factor for seed in range(25)) < 1


def test_bursts_are_found() -> None:
    errors = []
    for seed in range(8):
        found = fit(with_bursts(row_blocks(seed), seed))
        assert found.reason is None
        assert found.log_bayes_factor > 100
        errors += [(found.x[:, 1] - 0.01) / found.std[:, 1], np.log(found.x[:, 2] / 1000) * 1000 / found.std[:, 2]]
        assert np.all(found.std[:, 0] == 0)
    assert np.abs(errors[::2]).max() < 4
    assert 0.5 < np.std(errors[::2]) < 1.5


def test_a_single_burst() -> None:
    made = row_blocks()
    made[0].weights[10, 3] = made[0].weights.max()
    made[0].residual[10, 3] = 40 / np.sqrt(made[0].weights[10, 3])
    found = fit(made)
    assert found.log_bayes_factor > 100
    assert found.reason is None


def test_masked_rows() -> None:
    block = with_bursts(row_blocks())[0]
    u = np.abs(block.residual) ** 2 * block.weights
    found = fit(with_bursts(row_blocks()))
    threshold = found.x[0, 0]
    assert threshold == pytest.approx(np.log(100 * np.count_nonzero(block.weights)), rel=1e-12)
    factor = Outliers().weight_factor(block, found.x[0])
    np.testing.assert_array_equal(factor, np.where(u > threshold, 0.0, 1.0))
    good = row_blocks("others")[0]
    assert np.all(Outliers().weight_factor(good, found.x[0]) == 1)


def unexplained(made: list[RowBlock]) -> list[RowBlock]:
    """Let half of the baselines have residuals ten times the noise, as the gain of an antenna makes them."""
    scale = np.where(np.arange(made[0].shape[1]) % 2, 10, 1)
    return [replace(one, residual=scale * one.residual) for one in made]


def test_bursts_beside_residuals_that_are_larger_than_noise() -> None:
    fractions = []
    for seed in range(8):
        made = with_bursts(unexplained(row_blocks(seed)), seed)
        alone = fit(made)
        assert alone.reason is not None
        assert alone.levels is not None
        assert np.all((alone.levels[:, 1::2] > 30) & (alone.levels[:, 1::2] < 300))
        assert np.all((alone.levels[:, ::2] >= 1) & (alone.levels[:, ::2] < 3))
        beside = Outliers().at_levels(alone.levels)
        found = fit(made, beside)
        assert found.reason is None
        assert found.log_bayes_factor > 100
        fractions.append(found.x[:, 1])
        # Of the baselines with larger residuals only what is far beyond these is left out.
        kept = beside.weight_factor(made[0], found.x[0]) > 0
        u = np.abs(made[0].residual) ** 2 * made[0].weights
        threshold = found.x[0, 0] * alone.levels[0]
        np.testing.assert_array_equal(kept, u <= threshold)
        assert np.mean(kept[:, 1::2]) > 0.98
    assert np.mean(fractions) == pytest.approx(0.01, rel=0.3)


def test_larger_residuals_alone_are_no_bursts() -> None:
    for seed in range(8):
        made = unexplained(row_blocks(seed))
        alone = fit(made)
        assert alone.log_bayes_factor <= 0
        assert alone.levels is not None
        assert fit(made, Outliers().at_levels(alone.levels)).log_bayes_factor < 1


def test_levels_are_settings() -> None:
    made = with_bursts(unexplained(row_blocks()))
    levels = fit(made).levels
    assert levels is not None
    beside = Outliers().at_levels(levels)
    x = np.array([12.0, 0.01, 1000.0])
    again = make_reweighting("outliers", json.loads(json.dumps(beside.describe())))
    for block in made:
        np.testing.assert_array_equal(again.weight_factor(block, x), beside.weight_factor(block, x))
    assert again.at_own_level
    assert not again.beside_noise.at_own_level
    assert Outliers().describe() == {}
    with pytest.raises(InputError, match="not understood"):
        make_reweighting("outliers", {"levels": [[0.5] * EXPERIMENT.observation.Nbls] * 2})


def test_whole_times() -> None:
    made = row_blocks()
    rng = generator(3, "times")
    for block in made:
        hit = np.zeros(block.shape, dtype=bool)
        hit[[17, 40]] = rng.random((2, block.shape[1])) < 0.8
        block.residual[:] = np.where(hit, 20, 1) * block.residual
    found = fit(made)
    assert found.reason is None
    assert found.log_bayes_factor > 100
    factor = Outliers().weight_factor(made[0], found.x[0])
    assert not factor[[17, 40]].any()
    assert np.delete(factor, [17, 40], axis=0).all()


def lasting(block: RowBlock) -> np.ndarray:
    return np.where(np.arange(block.shape[1]) == 4, 20, 1) * block.residual


def gathered(block: RowBlock) -> np.ndarray:
    baseline, time = np.arange(block.shape[1]) == 4, np.arange(block.shape[0]) % 7 == 0
    return np.where(baseline & time[:, np.newaxis], 20, 1) * block.residual


def bright(block: RowBlock) -> np.ndarray:
    return block.residual + np.where(np.abs(block.vis) > np.quantile(np.abs(block.vis), 0.97), 0.3, 0) * block.vis


def many(block: RowBlock) -> np.ndarray:
    return np.where(generator(4, "many", block.channel).random(block.shape) < 0.3, 10, 1) * block.residual


def loud(block: RowBlock) -> np.ndarray:
    return 1.5 * block.residual


@pytest.mark.parametrize(
    ("what", "words"),
    [(lasting, "gather"), (gathered, "gather"), (bright, "bright"), (many, "not a few"), (loud, "not a few")],
)
def test_other_errors_are_refused(what, words: str) -> None:
    made = row_blocks()
    for block in made:
        block.residual[:] = what(block)
    found = fit(made)
    assert found.log_bayes_factor <= 0
    assert found.reason is not None
    assert words in found.reason


def test_drawn_bursts_are_few() -> None:
    rng = generator(6, "draw")
    block = row_blocks()[0]
    x = Outliers().draw(EXPERIMENT, rng, 0.1)
    assert x[1] == pytest.approx(0.01)
    assert 100 <= x[2] <= 1e4
    changed = Outliers().inject(block.residual, block, x, rng) != block.residual
    assert np.mean(changed[block.weights > 0]) == pytest.approx(0.01, abs=0.01)
    assert not changed[block.weights == 0].any()


@pytest.mark.parametrize("log_scale", [-5.0, 0.0, 10.0, 40.0, 800.0])
def test_bursts_of_any_scale_have_a_density(log_scale: float) -> None:
    """Which no difference of probabilities gives where the scale is far beyond most bins."""
    log_p = log_broad(log_scale)
    assert np.all(np.isfinite(log_p))
    assert np.exp(log_p).sum() == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize("size", [1e-9, 1.0, 1e6, 1e20, 1e150])
def test_residuals_of_any_size_are_weighed(size: float) -> None:
    found = fit(row_blocks(scale=size))
    assert np.isfinite(found.log_bayes_factor)
    assert np.all(np.isfinite(found.x))
