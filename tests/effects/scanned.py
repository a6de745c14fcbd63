"""What effects whose candidates are scanned one by one must satisfy."""

from __future__ import annotations

import json
import pickle

import numpy as np

from hydrabeam_mpi.data.observation import IntArray
from hydrabeam_mpi.effects.base import ScannedEffect
from hydrabeam_mpi.effects.scene import Scene
from hydrabeam_mpi.random import complex_normal, generator
from tests.effects.small import matrix_at


def with_random_data(scene: Scene) -> Scene:
    """Give the scene residuals and weights to scan, some of them zero."""
    rng = generator(11, "scan")
    scene.residual = complex_normal(rng, scene.shape)
    scene.weights = rng.uniform(0.5, 2.0, scene.shape) * (rng.uniform(size=scene.shape) > 0.2)
    return scene


def check_scan(effect: ScannedEffect, scene: Scene, hypotheses: IntArray) -> None:
    """Compare what a scan says of candidates with the columns that they have as part of the effect."""
    scene = with_random_data(scene)
    sums, norms = effect.scan(scene)
    n = effect.n_hypotheses(scene.experiment)
    assert len(sums) == len(norms) == n
    assert sums.shape == norms.shape
    chosen = effect.at(scene.experiment, hypotheses)
    parameters = chosen.parameters(scene.experiment)
    assert parameters.trials == n
    linear = np.flatnonzero(~parameters.refined)
    np.testing.assert_array_equal(parameters.element[linear], np.repeat(np.arange(len(hypotheses)), sums.shape[1]))
    design = matrix_at(chosen, scene, np.zeros(len(parameters)))[..., linear]
    expected = np.einsum("tb,tbp,tb->p", scene.weights, design.conj(), scene.residual).real
    np.testing.assert_allclose(sums[hypotheses].reshape(-1), expected, rtol=0, atol=1e-10 * np.abs(expected).max())
    power = np.einsum("tb,tbp->p", scene.weights, np.abs(design) ** 2)
    np.testing.assert_allclose(norms[hypotheses].reshape(-1), power, rtol=1e-10)


def check_description(effect: ScannedEffect, scene: Scene, hypotheses: IntArray) -> None:
    """An effect is what its class and its description say, and without elements it is nothing."""
    chosen = effect.at(scene.experiment, hypotheses)
    again = type(effect)(**json.loads(json.dumps(chosen.describe())))
    names = chosen.parameters(scene.experiment).names
    assert again.parameters(scene.experiment).names == names
    assert pickle.loads(pickle.dumps(chosen)).parameters(scene.experiment).names == names
    nothing = np.zeros(0)
    assert len(effect.parameters(scene.experiment)) == 0
    assert effect.columns(scene, nothing).matrix().shape == (scene.vis.size, 0)
    np.testing.assert_array_equal(effect.added(scene, nothing), np.zeros(scene.shape))
    np.testing.assert_array_equal(effect.factor(scene, nothing), np.ones(scene.shape))
