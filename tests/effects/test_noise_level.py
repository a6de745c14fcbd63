"""The noise level is found as it is, by antenna where it differs, and never where residuals are not noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydrabeam_mpi.effects.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.noise_level import NoiseLevel
from hydrabeam_mpi.effects.reweighting import ReweightingFit
from hydrabeam_mpi.effects.scene import Scene
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.random import complex_normal, generator
from tests.effects.small import small_experiment, small_scene

EXPERIMENT = small_experiment(n_times=40)
N_ANTENNAS = len(EXPERIMENT.antennas_in_use)


def scenes(*key: int | str) -> list[Scene]:
    """Both channels with noise of a hundredth of the largest visibility, some rows without weight."""
    made = []
    for channel in range(2):
        scene = small_scene(EXPERIMENT, channel)
        sigma = 0.01 * np.abs(scene.vis).max()
        rng = generator(1, "noise", channel, *key)
        scene.residual = sigma * complex_normal(rng, scene.shape)
        scene.weights = np.where(rng.random(scene.shape) < 0.1, 0.0, sigma**-2)
        made.append(scene)
    return made


def fit(made: list[Scene], taken: float = 0.0) -> ReweightingFit:
    effect = NoiseLevel()
    sums = np.array([effect.sums(scene, scene.residual * np.sqrt(scene.weights)) for scene in made])
    assert sums.shape == (2, effect.n_sums(EXPERIMENT))
    return effect.fit(EXPERIMENT, sums, np.full(2, taken))


def noisier(made: list[Scene], x: np.ndarray, *key: int) -> list[Scene]:
    return [
        replace(one, residual=NoiseLevel().inject(one.residual, one, x, generator(2, "more", f, *key)))
        for f, one in enumerate(made)
    ]


def test_good_noise_needs_no_scale() -> None:
    found = [fit(scenes(seed)) for seed in range(40)]
    assert max(one.log_bayes_factor for one in found) < 4
    assert all(one.names == ("noise scale",) and one.reason is None for one in found)


def test_a_common_scale() -> None:
    errors = []
    for seed in range(20):
        found = fit(noisier(scenes(seed), np.array([1.3]), seed))
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
    mean = np.exp(np.log(x[1:]).mean())
    truth = np.array([mean, *(x[1:] / mean)])
    errors = []
    for seed in range(10):
        found = fit(noisier(scenes(seed), x, seed))
        assert found.x.shape == (2, 1 + N_ANTENNAS)
        others = np.delete(found.x, [0, 3], axis=1)
        np.testing.assert_allclose(others, others[:, :1] * np.ones(N_ANTENNAS - 1), rtol=1e-4)
        errors.append((found.x[:, 3] - truth[3]) / found.std[:, 3])
    assert abs(np.mean(errors)) < 0.7
    assert 0.6 < np.std(errors) < 1.4


def test_noisy_antennas() -> None:
    x = np.ones(1 + N_ANTENNAS)
    x[[2, 5]] = 2.0, 1.5
    x[0] = 1.2
    found = fit(noisier(scenes(), x))
    assert len(found.names) == 1 + N_ANTENNAS
    assert found.names[2] == f"antenna {EXPERIMENT.observation.antenna_numbers[1]} noise scale"
    mean = np.exp(np.log(x[1:]).mean())
    truth = np.array([x[0] * mean, *(x[1:] / mean)])
    assert np.abs((found.x - truth) / found.std).max() < 4
    assert found.std.max() < 0.15


def test_the_weights_follow() -> None:
    x = np.array([1.2, *np.linspace(0.9, 1.4, N_ANTENNAS)])
    scene = noisier(scenes(), np.maximum(x, 1))[0]
    factor = NoiseLevel().weight_factor(scene, np.maximum(x, 1))
    assert factor.shape == scene.shape
    z = scene.residual * np.sqrt(scene.weights * factor)
    assert abs(np.mean(np.abs(z[scene.weights > 0]) ** 2) - 1) < 0.15
    numbers = EXPERIMENT.observation.antenna_numbers.tolist()
    first, second = EXPERIMENT.observation.antpairs[7]
    scale = x[0] * np.sqrt(x[1 + numbers.index(first)] * x[1 + numbers.index(second)])
    np.testing.assert_allclose(NoiseLevel().weight_factor(scene, x)[:, 7], scale**-2, rtol=1e-12)


def test_what_the_beam_took_does_not_count_as_quiet() -> None:
    """Project the noise on what a fit of 300 complex columns leaves: s is 1, not sqrt(1 - 300/840)."""
    made = scenes()
    for scene in made:
        scene.weights = np.full(scene.shape, scene.weights.max())
        columns = complex_normal(generator(3, "columns", scene.channel), (scene.residual.size, 300))
        fitted = columns @ np.linalg.lstsq(columns, scene.residual.reshape(-1))[0]
        scene.residual = scene.residual - fitted.reshape(scene.shape)
    corrected = fit(made, taken=600.0)
    assert corrected.log_bayes_factor < 4
    assert np.abs(corrected.x[:, 0] - 1).max() < 0.1
    assert fit(made).x.max() < 0.9


def test_shares_by_baseline() -> None:
    """Baselines that the beam fitted closely are not taken for quiet antennas."""
    effect, made = NoiseLevel(), scenes()
    close = np.any(EXPERIMENT.antenna_index == EXPERIMENT.antennas_in_use[0], axis=1)
    for scene in made:
        scene.residual[:, close] *= np.sqrt(0.5)
    sums = np.array([effect.sums(scene, scene.residual * np.sqrt(scene.weights)) for scene in made])
    counts = sums[:, : EXPERIMENT.observation.Nbls]
    assert len(effect.fit(EXPERIMENT, sums, np.zeros(2)).names) > 1
    told = effect.fit(EXPERIMENT, sums, np.where(close, counts, 0.0))
    assert len(told.names) == 1
    assert told.log_bayes_factor < 4


def gains(scene: Scene, rng: np.random.Generator) -> np.ndarray:
    x = AntennaGains().draw(EXPERIMENT, rng, 0.05)
    return (AntennaGains().factor(scene, x) - 1) * scene.vis


def other_beam(scene: Scene, rng: np.random.Generator) -> np.ndarray:
    return scene.spread(0.05 * np.abs(scene.vis).max() * complex_normal(rng, (len(scene.times), len(scene.groups))))


def drift(scene: Scene, rng: np.random.Generator) -> np.ndarray:
    return scene.residual * np.linspace(0, 1.5, len(scene.times))[:, np.newaxis]


def bursts(scene: Scene, rng: np.random.Generator) -> np.ndarray:
    return np.where(rng.random(scene.shape) < 0.01, 30, 0) * scene.residual


@pytest.mark.parametrize(
    ("what", "word"),
    [(gains, "phase|large in some|times"), (other_beam, "redundant"), (drift, "times"), (bursts, "large in some")],
)
def test_residuals_that_are_not_noise_are_refused(what, word: str) -> None:
    made = scenes()
    for scene in made:
        scene.residual = scene.residual + what(scene, generator(4, "error", scene.channel))
    found = fit(made)
    assert found.chi2_drop > 100
    assert found.log_bayes_factor <= 0
    assert found.reason is not None
    assert any(part in found.reason for part in word.split("|"))


def test_noise_cannot_be_taken_away() -> None:
    scene = scenes()[0]
    with pytest.raises(InputError, match="taken away"):
        NoiseLevel().inject(scene.residual, scene, np.array([0.8]), generator(5, "less"))


def test_drawn_scales_are_as_strong_as_asked() -> None:
    rng = generator(6, "draw")
    draws = np.array([NoiseLevel().draw(EXPERIMENT, rng, 0.2) for _ in range(400)])
    assert draws.shape == (400, 1)
    assert draws.min() >= 1
    assert np.sqrt(np.mean((draws - 1) ** 2)) == pytest.approx(0.2, rel=0.15)
