from dataclasses import replace

import numpy as np
import pytest

from hydrabeam_mpi.effects.auto_coupling import AutoCoupling
from hydrabeam_mpi.effects.beam_visibilities import beam_visibilities
from hydrabeam_mpi.effects.experiment import Experiment
from hydrabeam_mpi.effects.scene import Scene
from hydrabeam_mpi.random import complex_normal, generator
from tests.effects.small import small_experiment, small_scene


@pytest.fixture(scope="module")
def experiment() -> Experiment:
    return small_experiment(n_times=4)


@pytest.fixture
def scene(experiment: Experiment) -> Scene:
    return small_scene(experiment)


def test_known_truth(experiment: Experiment, scene: Scene) -> None:
    """Voltages that hear a fraction of each other, with autocorrelations summed source by source."""
    observation = experiment.observation
    numbers = observation.antenna_numbers.tolist()
    eps = 1e-3 * complex_normal(generator(3, "eps"), (7, 7))  # of i's voltage in j
    autos = np.zeros(observation.Ntimes)
    for t in range(observation.Ntimes):
        index, za, az = scene.positions.above_horizon(t)
        power = experiment.basis.synthesize(experiment.prior_mean[0], za, az).real
        autos[t] = 0.5 * sum(flux * p for flux, p in zip(experiment.sky.flux[0, index], power, strict=True))
    assert autos.max() > 1.2 * autos.min()

    effect = AutoCoupling(observation.antpairs.tolist())
    x = []
    for bl, (one, two) in enumerate(observation.antpairs.tolist()):
        if experiment.redundant.flipped[bl]:
            one, two = two, one
        i, j = numbers.index(one), numbers.index(two)
        amplitude = np.conj(eps[i, j]) + eps[j, i]
        x += [amplitude.real, amplitude.imag]
    added = effect.added(scene, np.array(x))
    added = np.where(experiment.redundant.flipped, added.conj(), added)
    for bl, (one, two) in enumerate(observation.antpairs.tolist()):
        i, j = numbers.index(one), numbers.index(two)
        np.testing.assert_allclose(added[:, bl], np.conj(eps[i, j]) * autos + eps[j, i] * autos, rtol=1e-10)


def test_autocorrelations_follow_the_beam(scene: Scene) -> None:
    """They are integrated once, and again for another beam or other times."""
    zero = np.zeros((1, 3))
    first = beam_visibilities(scene, zero)
    assert beam_visibilities(scene, zero) is first
    np.testing.assert_array_equal(beam_visibilities(replace(scene, times=scene.times[1:3]), zero), first[1:3])
    old = scene.beam
    scene.beam = lambda za, az: 2 * old(za, az)
    np.testing.assert_allclose(beam_visibilities(scene, zero), 2 * first, rtol=1e-12)
    assert beam_visibilities(replace(scene, times=scene.times[:0]), zero).shape == (0, 1)
