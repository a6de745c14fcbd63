import numpy as np

from hydrabeam_mpi.effects.antenna_delays import AntennaDelays
from hydrabeam_mpi.random import complex_normal, generator
from tests.effects.small import matrix_at, small_experiment, small_scene, with_effect

C = 299792458.0


def test_delay_makes_up_for_the_way_to_the_source() -> None:
    """An antenna nearer to a source by r.s hears it r.s/c early; delayed by as much, all hear it at once."""
    experiment = small_experiment()
    antpos = experiment.observation.antpos
    towards = np.array([0.3, -0.5, np.sqrt(1 - 0.34)])
    order = np.argsort(experiment.observation.antenna_numbers)
    index = order[
        np.searchsorted(experiment.observation.antenna_numbers, experiment.observation.antpairs, sorter=order)
    ]
    for channel, freq in enumerate(experiment.observation.freqs):
        scene = small_scene(experiment, channel)
        path = (antpos[index[:, 1]] - antpos[index[:, 0]]) @ towards
        fringe = np.exp(2j * np.pi * freq * path / C)
        fringe = np.where(experiment.redundant.flipped, fringe.conj(), fringe)
        x = (antpos @ towards)[experiment.antennas_in_use] / C * 1e9
        np.testing.assert_allclose(AntennaDelays().factor(scene, x) * fringe, np.ones(scene.shape), atol=1e-6)


def test_one_law_for_all_channels() -> None:
    """With phases far beyond a turn, several channels together have the delays, but for what all share."""
    experiment = small_experiment(freqs=(131e6, 151e6))
    effect = AntennaDelays()
    scenes = [small_scene(experiment, channel) for channel in range(2)]
    n = len(effect.parameters(experiment))
    truth = 20 * generator(4, "delays").standard_normal(n)
    sigma = 0.01 * float(np.abs(scenes[0].vis).max())
    rng = generator(5, "delays")
    data = [with_effect(effect, scene, truth) + sigma * complex_normal(rng, scene.shape) for scene in scenes]
    x = truth + 0.2 * rng.standard_normal(n)
    for _ in range(6):
        design = np.concatenate([matrix_at(effect, scene, x).reshape(-1, n) for scene in scenes])
        left = np.concatenate([(d - with_effect(effect, s, x)).reshape(-1) for d, s in zip(data, scenes, strict=True)])
        fisher = 2 * (design.conj().T @ design).real / sigma**2
        x = x + np.linalg.pinv(fisher, rcond=1e-9) @ (2 * (design.conj().T @ left).real / sigma**2)
    error = (x - x.mean()) - (truth - truth.mean())
    assert np.sqrt(error @ fisher @ error / (n - 1)) < 2.5
    assert np.abs(error).max() < 0.05
