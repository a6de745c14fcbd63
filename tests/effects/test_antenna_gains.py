import numpy as np

from hydrabeam_mpi.effects.antenna_gains import AntennaGains
from hydrabeam_mpi.random import generator
from tests.effects.small import small_experiment, small_scene


def test_flipped_baselines_are_conjugated() -> None:
    """The gains that multiply V_jk as g_j g_k* multiply the group's V_kj as g_k g_j*."""
    experiment = small_experiment()
    scene = small_scene(experiment)
    x = AntennaGains().draw(experiment, generator(2, "gains"), 0.3)
    gains = np.exp(x[0::2] + 1j * x[1::2])
    numbers = experiment.observation.antenna_numbers.tolist()
    first, second = (
        gains[[numbers.index(number) for number in column]] for column in experiment.observation.antpairs.T
    )
    factor = AntennaGains().factor(scene, x)[0]
    flipped = experiment.redundant.flipped
    np.testing.assert_allclose(np.where(flipped, factor.conj(), factor), first * second.conj(), rtol=1e-12)
