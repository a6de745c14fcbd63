from dataclasses import replace

import numpy as np

from hydrabeam_mpi.effects.scene import Scene
from hydrabeam_mpi.effects.sources import EARTH_RATE
from hydrabeam_mpi.effects.timestamp import Timestamp
from hydrabeam_mpi.model.positions import ApparentPositions, RotatedPositions
from tests.effects.direct import assert_same, visibilities
from tests.effects.small import small_experiment, small_scene, with_effect


def up(scene: Scene, itime: int) -> list[int]:
    return scene.positions.above_horizon(itime)[0].tolist()


def test_visibilities_are_those_of_later_times() -> None:
    """Sources where a sidereal clock that is ahead puts them, with those that rise and without those that set."""
    experiment = small_experiment(n_sources=2000)
    scene = small_scene(experiment)
    effect = Timestamp()
    scene.integrate_for([effect])
    for seconds in (100.0, -200.0):
        observation = replace(experiment.observation, lsts=experiment.observation.lsts + EARTH_RATE * seconds)
        later = replace(scene, positions=RotatedPositions(experiment.sky, observation))
        changes = [(set(up(later, t)) - set(up(scene, t)), set(up(scene, t)) - set(up(later, t))) for t in scene.times]
        assert all(any(kind) for kind in zip(*changes, strict=True))
        assert_same(with_effect(effect, scene, np.array([seconds])), visibilities(later), scene)


def test_apparent_places_turn_alike() -> None:
    """Astropy's places half a minute later, to within what precession and polar motion change of the axis."""
    experiment = small_experiment()
    observation = experiment.observation
    scene = replace(small_scene(experiment), positions=ApparentPositions(experiment.sky, observation))
    scene.vis = visibilities(scene)
    effect = Timestamp()
    scene.integrate_for([effect])
    later = replace(observation, times=observation.times + 30.0 / 86400)
    scene_later = replace(scene, positions=ApparentPositions(experiment.sky, later))
    truth = visibilities(scene_later)
    change = np.abs(truth - scene.vis).max()
    np.testing.assert_allclose(with_effect(effect, scene, np.array([30.0])), truth, rtol=0, atol=1e-4 * change)


def test_places_that_are_kept_are_not_mistaken_for_turned_ones() -> None:
    scene = small_scene(small_experiment())
    effect = Timestamp()
    scene.integrate_for([effect])
    change = effect.added(scene, np.array([60.0]))
    scene.places = {}
    scene.integrate_for([effect])
    assert len(scene.places) == len(scene.times)
    assert_same(effect.added(scene, np.array([60.0])), change, scene, rtol=1e-12)
    assert_same(scene.spread(scene.integrals["timestamp"])[..., 0], scene.vis, scene)
