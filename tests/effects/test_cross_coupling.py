import numpy as np
import pytest

from hydrabeam_mpi.effects.cross_coupling import CrossCoupling
from hydrabeam_mpi.effects.experiment import Experiment
from hydrabeam_mpi.effects.scene import Scene
from hydrabeam_mpi.errors import InputError
from tests.effects.small import small_experiment, small_scene


@pytest.fixture(scope="module")
def experiment() -> Experiment:
    return small_experiment(n_times=4)


@pytest.fixture
def scene(experiment: Experiment) -> Scene:
    return small_scene(experiment)


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


def test_baselines_in_either_order(experiment: Experiment) -> None:
    one, two = experiment.observation.antpairs[5].tolist()
    names = [CrossCoupling([pair]).parameters(experiment).names for pair in ((one, two), (two, one))]
    assert names[0] == names[1]


def test_wrong_baselines(experiment: Experiment) -> None:
    one, two = experiment.observation.antpairs[5].tolist()
    with pytest.raises(InputError, match="no baseline 3-99"):
        CrossCoupling([(3, 99)]).parameters(experiment)
    with pytest.raises(InputError, match="named twice"):
        CrossCoupling([(one, two), (two, one)]).parameters(experiment)
