"""The noise level is found as it is, by antenna where it differs, and never where residuals are not noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.interface.reweighting import ReweightingFit
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.noise.noise_level import NoiseLevel
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.random import complex_normal, generator
from tests.effects.small import small_block, small_setup

EXPERIMENT = small_setup(n_times=40)
N_ANTENNAS = len(EXPERIMENT.antennas_in_use)


def row_blocks(*key: int | str) -> list[RowBlock]:
    """Both channels with noise of a hundredth of the largest visibility, some rows without weight."""
    made = []
    for channel in range(2):
        block = small_block(EXPERIMENT, channel)
        sigma = 0.01 * np.abs(block.vis).max()
        rng = generator(1, "noise", channel, *key)
        block.residual[:] = sigma * complex_normal(rng, block.shape)
        block.weights[:] = np.where(rng.random(block.shape) < 0.1, 0.0, sigma**-2)
        made.append(block)
    return made


def fit(made: list[RowBlock], taken: float = 0.0) -> ReweightingFit:
    effect = NoiseLevel()
    sums = np.array([effect.sums(block, block.residual * np.sqrt(block.weights)) for block in made])
    assert sums.shape == (2, effect.n_sums(EXPERIMENT))
    return effect.fit(EXPERIMENT, sums, np.full(2, taken))


def noisier(made: list[RowBlock], x: np.ndarray, *key: int) -> list[RowBlock]:
    return [
        replace(one, residual=NoiseLevel().inject(one.residual, one, x, generator(2, "more", f, *key)))
        for f, one in enumerate(made)
    ]


def test_good_noise_needs_no_scale() -> None:
    found = [fit(row_blocks(seed)) for seed in range(40)]
    assert max(one.log_bayes_factor for one in found) < 4
    assert all(one.names == ("noise scale",) and one.reason is None for one in found)


def test_a_common_scale() -> None:
    errors = []
    for seed in range(20):
        found = fit(noisier(row_blocks(seed), np.array([1.3]), seed))
        assert found.names == ("noise scale",)
        assert found.reason is None
        assert found.log_bayes_factor > 50
        assert found.chi2_drop > 100
        errors.append((found.x - 1.3) / found.std)
    assert abs(np.mean(errors)) < 0.6
    assert 0.7 < np.std(errors) < 1.3


def test_one_noisy_antenna_leaves_the_others_alike() -> None:
    """Their scales are not fitted to their own scatter; all that is uncertain of them is what is common."""
    x = np.ones(1 + N_ANTENNAS)
    x[3] = 2.5
    errors = []
    for seed in range(10):
        found = fit(noisier(row_blocks(seed), x, seed))
        assert found.x.shape == (2, 1 + N_ANTENNAS)
        assert np.flatnonzero(NoiseLevel().is_told(found.x)).tolist() == [0, 3]
        assert np.all(np.delete(found.x, [0, 3], axis=1) == 1)
        assert np.all(np.delete(found.std, [0, 3], axis=1) == 0)
        errors.append((found.x - x)[:, [0, 3]] / found.std[:, [0, 3]])
    assert np.abs(np.mean(errors, axis=(0, 1))).max() < 0.7
    assert 0.6 < np.std(errors) < 1.4


def test_noisy_antennas() -> None:
    x = np.ones(1 + N_ANTENNAS)
    x[[2, 5]] = 2.0, 1.5
    x[0] = 1.2
    found = fit(noisier(row_blocks(), x))
    assert len(found.names) == 1 + N_ANTENNAS
    assert found.names[2] == f"antenna {EXPERIMENT.observation.antenna_numbers[1]} noise scale"
    assert np.flatnonzero(NoiseLevel().is_told(found.x)).tolist() == [0, 2, 5]
    differ = [0, 2, 5]
    assert np.abs((found.x - x) / np.maximum(found.std, 1e-12))[:, differ].max() < 4
    assert found.std.max() < 0.25


def test_the_weights_follow() -> None:
    x = np.array([1.2, *np.linspace(0.9, 1.4, N_ANTENNAS)])
    block = noisier(row_blocks(), np.maximum(x, 1))[0]
    factor = NoiseLevel().weight_factor(block, np.maximum(x, 1))
    assert factor.shape == block.shape
    z = block.residual * np.sqrt(block.weights * factor)
    assert abs(np.mean(np.abs(z[block.weights > 0]) ** 2) - 1) < 0.15
    numbers = EXPERIMENT.observation.antenna_numbers.tolist()
    first, second = EXPERIMENT.observation.antpairs[7]
    scale = x[0] * np.sqrt(x[1 + numbers.index(first)] * x[1 + numbers.index(second)])
    np.testing.assert_allclose(NoiseLevel().weight_factor(block, x)[:, 7], scale**-2, rtol=1e-12)


def test_what_the_beam_took_does_not_count_as_quiet() -> None:
    """Project the noise on what a fit of 300 complex columns leaves: s is 1, not sqrt(1 - 300/840)."""
    made = row_blocks()
    for block in made:
        block.weights[:] = np.full(block.shape, block.weights.max())
        columns = complex_normal(generator(3, "columns", block.channel), (block.residual.size, 300))
        fitted = columns @ np.linalg.lstsq(columns, block.residual.reshape(-1))[0]
        block.residual[:] = block.residual - fitted.reshape(block.shape)
    corrected = fit(made, taken=600.0)
    assert corrected.log_bayes_factor < 4
    assert np.abs(corrected.x[:, 0] - 1).max() < 0.1
    assert fit(made).x.max() < 0.9


def test_shares_by_baseline() -> None:
    """Baselines that the beam fitted closely are not taken for quiet antennas."""
    effect, made = NoiseLevel(), row_blocks()
    close = np.any(EXPERIMENT.antenna_index == EXPERIMENT.antennas_in_use[0], axis=1)
    for block in made:
        block.residual[:, close] *= np.sqrt(0.5)
    sums = np.array([effect.sums(block, block.residual * np.sqrt(block.weights)) for block in made])
    counts = sums[:, : EXPERIMENT.observation.Nbls]
    assert len(effect.fit(EXPERIMENT, sums, np.zeros(2)).names) > 1
    told = effect.fit(EXPERIMENT, sums, np.where(close, counts, 0.0))
    assert len(told.names) == 1
    assert told.log_bayes_factor < 4


def gains(block: RowBlock, rng: np.random.Generator) -> np.ndarray:
    x = AntennaGains().draw(EXPERIMENT, rng, 0.05)
    return (AntennaGains().factor(block, x) - 1) * block.vis


def other_beam(block: RowBlock, rng: np.random.Generator) -> np.ndarray:
    return block.spread(0.05 * np.abs(block.vis).max() * complex_normal(rng, (len(block.times), len(block.groups))))


def drift(block: RowBlock, rng: np.random.Generator) -> np.ndarray:
    return block.residual * np.linspace(0, 1.5, len(block.times))[:, np.newaxis]


def bursts(block: RowBlock, rng: np.random.Generator) -> np.ndarray:
    return np.where(rng.random(block.shape) < 0.01, 30, 0) * block.residual


@pytest.mark.parametrize(
    ("what", "word"),
    [(gains, "phase|large in some|times"), (other_beam, "redundant"), (drift, "times"), (bursts, "large in some")],
)
def test_residuals_that_are_not_noise_are_refused(what, word: str) -> None:
    made = row_blocks()
    for block in made:
        block.residual[:] = block.residual + what(block, generator(4, "error", block.channel))
    found = fit(made)
    assert found.chi2_drop > 100
    assert found.log_bayes_factor <= 0
    assert found.reason is not None
    assert any(part in found.reason for part in word.split("|"))


def test_noise_cannot_be_taken_away() -> None:
    block = row_blocks()[0]
    with pytest.raises(InputError, match="taken away"):
        NoiseLevel().inject(block.residual, block, np.array([0.8]), generator(5, "less"))


def test_drawn_scales_are_as_strong_as_asked() -> None:
    rng = generator(6, "draw")
    draws = np.array([NoiseLevel().draw(EXPERIMENT, rng, 0.2) for _ in range(400)])
    assert draws.shape == (400, 1)
    assert draws.min() >= 1
    assert np.sqrt(np.mean((draws - 1) ** 2)) == pytest.approx(0.2, rel=0.15)
