from dataclasses import replace

import numpy as np
import pytest

from hydrabeam_mpi.effects.cross_coupling import CrossCoupling
from hydrabeam_mpi.effects.experiment import Experiment
from hydrabeam_mpi.effects.scene import Scene
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.random import generator
from tests.effects.scanned import check_description, check_scan
from tests.effects.small import (
    check_adjoint,
    check_derivative,
    check_recovery,
    check_zero_is_nothing,
    small_experiment,
    small_scene,
)


@pytest.fixture(scope="module")
def experiment() -> Experiment:
    return small_experiment(n_times=4)


@pytest.fixture
def scene(experiment: Experiment) -> Scene:
    return small_scene(experiment)


def test_contract(experiment: Experiment, scene: Scene) -> None:
    effect = CrossCoupling().at(experiment, np.array([13, 2, 7]))
    x = effect.draw(experiment, generator(1, "cross"), 2.0)
    check_zero_is_nothing(effect, scene)
    check_derivative(effect, scene, x)
    check_adjoint(effect, scene, x)
    check_recovery(effect, scene, x, sigma=0.1 * float(np.abs(effect.added(scene, x)).max()))


def test_known_truth(experiment: Experiment, scene: Scene) -> None:
    """What the data as measured have on a baseline that its group has the other way round is conjugated."""
    flipped = np.flatnonzero(experiment.redundant.flipped)
    assert len(flipped)
    bls = np.array([flipped[0], np.flatnonzero(~experiment.redundant.flipped)[0]])
    effect = CrossCoupling().at(experiment, bls)
    excess = np.zeros(scene.shape, dtype=complex)
    excess[:, bls[0]], excess[:, bls[1]] = 3 - 4j, 5 + 6j
    added = effect.added(scene, np.array([3.0, 4.0, 5.0, 6.0]))
    np.testing.assert_array_equal(np.where(experiment.redundant.flipped, added.conj(), added), excess)
    one, two = experiment.observation.antpairs[bls[0]]
    names = effect.parameters(experiment).names
    assert names[:2] == (f"baseline {two}-{one} real", f"baseline {two}-{one} imaginary")


def test_scan(experiment: Experiment, scene: Scene) -> None:
    assert CrossCoupling().n_hypotheses(experiment) == 21
    check_scan(CrossCoupling(), scene, np.array([20, 3, 11]))
    check_description(CrossCoupling(), scene, np.array([4, 17]))


def test_some_baselines(experiment: Experiment, scene: Scene) -> None:
    """A scene without a baseline has nothing of it, and says nothing of it."""
    effect = CrossCoupling().at(experiment, np.array([3, 12]))
    bls = np.array([12, 14])
    part = replace(scene, bls=bls, member=scene.member[bls])
    part.vis, part.weights, part.residual = (a[:, bls] for a in (scene.vis, scene.weights, scene.vis))
    np.testing.assert_array_equal(effect.added(part, np.array([1.0, 2.0, 3.0, 4.0])), [[3 + 4j, 0]] * 4)
    sums, norms = CrossCoupling().scan(part)
    np.testing.assert_array_equal(np.flatnonzero(norms.any(axis=1)), bls)
    np.testing.assert_allclose(sums[12], [part.vis[:, 0].sum().real, part.vis[:, 0].sum().imag], rtol=1e-12)


def test_baselines_in_either_order(experiment: Experiment) -> None:
    one, two = experiment.observation.antpairs[5].tolist()
    names = [CrossCoupling([pair]).parameters(experiment).names for pair in ((one, two), (two, one))]
    assert names[0] == names[1]


def test_refusal(experiment: Experiment) -> None:
    assert CrossCoupling().refusal(experiment) is None
    refusal = CrossCoupling().refusal(replace(experiment, times=np.arange(1)))
    assert refusal is not None
    assert "several times" in refusal


def test_wrong_baselines(experiment: Experiment) -> None:
    one, two = experiment.observation.antpairs[5].tolist()
    with pytest.raises(InputError, match="no baseline 3-99"):
        CrossCoupling([(3, 99)]).parameters(experiment)
    with pytest.raises(InputError, match="named twice"):
        CrossCoupling([(one, two), (two, one)]).parameters(experiment)
