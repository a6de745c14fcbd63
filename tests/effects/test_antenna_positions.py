from dataclasses import replace

import numpy as np

from hydrabeam_mpi.effects.antenna_positions import AntennaPositions
from hydrabeam_mpi.random import generator
from tests.effects.direct import assert_same, row_vectors, visibilities
from tests.effects.small import check_derivative, small_experiment, small_scene, with_effect


def test_one_antenna_among_many() -> None:
    """Rows that have not moved keep their groups' integrals."""
    experiment = small_experiment()
    scene = small_scene(experiment, channel=1)
    effect = AntennaPositions()
    x = np.zeros(21)
    x[6:9] = [0.3, -0.2, 0.1]
    check_derivative(effect, scene, x, step=1e-4)
    change = effect.added(scene, x)
    touched = (scene.ant1 == 2) | (scene.ant2 == 2)
    assert not change[:, ~touched].any()
    assert change[:, touched].all()


def test_visibilities_are_those_of_the_moved_array() -> None:
    experiment = small_experiment()
    effect = AntennaPositions()
    x = effect.draw(experiment, generator(2, "positions"), 5.0)
    moved = replace(experiment.observation, antpos=experiment.observation.antpos + x.reshape(-1, 3))
    for channel in range(2):
        scene = small_scene(experiment, channel)
        scene.integrate_for([effect])
        there = replace(scene, experiment=replace(experiment, observation=moved))
        assert_same(visibilities(scene), scene.vis, scene)
        assert_same(with_effect(effect, scene, x), visibilities(scene, row_vectors(there)), scene)


def test_a_common_shift_changes_nothing() -> None:
    experiment = small_experiment()
    scene = small_scene(experiment)
    effect = AntennaPositions()
    scene.integrate_for([effect])
    # A power of two, so that differences cancel to the last digit.
    assert not effect.added(scene, np.tile([0.5, 0.25, 0.125], 7)).any()
