"""Few bursts are found and left out; what is not few, or lasts, or follows the model, is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydrabeam_mpi.effects.outliers import Outliers, log_broad
from hydrabeam_mpi.effects.reweighting import ReweightingFit
from hydrabeam_mpi.effects.scene import Scene
from hydrabeam_mpi.random import complex_normal, generator
from tests.effects.small import small_experiment, small_scene

EXPERIMENT = small_experiment(n_times=60)
BURSTS = np.array([15.0, 0.01, 1000.0])


def scenes(*key: int | str, scale: float = 1.0) -> list[Scene]:
    """Both channels with noise of a hundredth of the largest visibility, some rows without weight."""
    made = []
    for channel in range(2):
        scene = small_scene(EXPERIMENT, channel)
        sigma = 0.01 * np.abs(scene.vis).max()
        rng = generator(1, "noise", channel, *key)
        scene.residual = scale * sigma * complex_normal(rng, scene.shape)
        scene.weights = np.where(rng.random(scene.shape) < 0.1, 0.0, sigma**-2)
        made.append(scene)
    return made


def fit(made: list[Scene]) -> ReweightingFit:
    effect = Outliers()
    sums = np.array([effect.sums(scene, scene.residual * np.sqrt(scene.weights)) for scene in made])
    assert sums.shape == (2, effect.n_sums(EXPERIMENT))
    return effect.fit(EXPERIMENT, sums, np.zeros(2))


def with_bursts(made: list[Scene], *key: int | str) -> list[Scene]:
    return [
        replace(one, residual=Outliers().inject(one.residual, one, BURSTS, generator(2, "bursts", f, *key)))
        for f, one in enumerate(made)
    ]


def test_noise_has_no_outliers() -> None:
    assert max(fit(scenes(seed)).log_bayes_factor for seed in range(25)) < 1


def test_bursts_are_found() -> None:
    errors = []
    for seed in range(8):
        found = fit(with_bursts(scenes(seed), seed))
        assert found.reason is None
        assert found.log_bayes_factor > 100
        errors += [(found.x[:, 1] - 0.01) / found.std[:, 1], np.log(found.x[:, 2] / 1000) * 1000 / found.std[:, 2]]
        assert np.all(found.std[:, 0] == 0)
    assert np.abs(errors[::2]).max() < 4
    assert 0.5 < np.std(errors[::2]) < 1.5


def test_a_single_burst() -> None:
    made = scenes()
    made[0].weights[10, 3] = made[0].weights.max()
    made[0].residual[10, 3] = 40 / np.sqrt(made[0].weights[10, 3])
    found = fit(made)
    assert found.log_bayes_factor > 100
    assert found.reason is None


def test_masked_rows() -> None:
    scene = with_bursts(scenes())[0]
    u = np.abs(scene.residual) ** 2 * scene.weights
    found = fit(with_bursts(scenes()))
    threshold = found.x[0, 0]
    assert threshold == pytest.approx(np.log(100 * np.count_nonzero(scene.weights)), rel=1e-12)
    factor = Outliers().weight_factor(scene, found.x[0])
    np.testing.assert_array_equal(factor, np.where(u > threshold, 0.0, 1.0))
    good = scenes("others")[0]
    assert np.all(Outliers().weight_factor(good, found.x[0]) == 1)


def test_whole_times() -> None:
    made = scenes()
    rng = generator(3, "times")
    for scene in made:
        hit = np.zeros(scene.shape, dtype=bool)
        hit[[17, 40]] = rng.random((2, scene.shape[1])) < 0.8
        scene.residual = np.where(hit, 20, 1) * scene.residual
    found = fit(made)
    assert found.reason is None
    assert found.log_bayes_factor > 100
    factor = Outliers().weight_factor(made[0], found.x[0])
    assert not factor[[17, 40]].any()
    assert np.delete(factor, [17, 40], axis=0).all()


def lasting(scene: Scene) -> np.ndarray:
    return np.where(np.arange(scene.shape[1]) == 4, 20, 1) * scene.residual


def gathered(scene: Scene) -> np.ndarray:
    baseline, time = np.arange(scene.shape[1]) == 4, np.arange(scene.shape[0]) % 7 == 0
    return np.where(baseline & time[:, np.newaxis], 20, 1) * scene.residual


def bright(scene: Scene) -> np.ndarray:
    return scene.residual + np.where(np.abs(scene.vis) > np.quantile(np.abs(scene.vis), 0.97), 0.3, 0) * scene.vis


def many(scene: Scene) -> np.ndarray:
    return np.where(generator(4, "many", scene.channel).random(scene.shape) < 0.3, 10, 1) * scene.residual


def loud(scene: Scene) -> np.ndarray:
    return 1.5 * scene.residual


@pytest.mark.parametrize(
    ("what", "words"),
    [(lasting, "gather"), (gathered, "gather"), (bright, "bright"), (many, "not a few"), (loud, "not a few")],
)
def test_other_errors_are_refused(what, words: str) -> None:
    made = scenes()
    for scene in made:
        scene.residual = what(scene)
    found = fit(made)
    assert found.log_bayes_factor <= 0
    assert found.reason is not None
    assert words in found.reason


def test_drawn_bursts_are_few() -> None:
    rng = generator(6, "draw")
    scene = scenes()[0]
    x = Outliers().draw(EXPERIMENT, rng, 0.1)
    assert x[1] == pytest.approx(0.01)
    assert 100 <= x[2] <= 1e4
    changed = Outliers().inject(scene.residual, scene, x, rng) != scene.residual
    assert np.mean(changed[scene.weights > 0]) == pytest.approx(0.01, abs=0.01)
    assert not changed[scene.weights == 0].any()


@pytest.mark.parametrize("log_scale", [-5.0, 0.0, 10.0, 40.0, 800.0])
def test_bursts_of_any_scale_have_a_density(log_scale: float) -> None:
    """Which no difference of probabilities gives where the scale is far beyond most bins."""
    log_p = log_broad(log_scale)
    assert np.all(np.isfinite(log_p))
    assert np.exp(log_p).sum() == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize("size", [1e-9, 1.0, 1e6, 1e20, 1e150])
def test_residuals_of_any_size_are_weighed(size: float) -> None:
    found = fit(scenes(scale=size))
    assert np.isfinite(found.log_bayes_factor)
    assert np.all(np.isfinite(found.x))
