from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from hydrabeam_mpi.data.observation import FloatArray, IntArray
from hydrabeam_mpi.effects.experiment import Experiment
from hydrabeam_mpi.effects.horizon import EDGES, RINGS, SECTORS, Horizon
from hydrabeam_mpi.effects.scene import Scene
from hydrabeam_mpi.effects.sources import Sources
from hydrabeam_mpi.model.positions import SourcePositions
from hydrabeam_mpi.random import generator
from tests.effects.small import (
    check_adjoint,
    check_derivative,
    check_recovery,
    check_zero_is_nothing,
    small_experiment,
    small_scene,
)


def wide_scene() -> tuple[Experiment, Scene]:
    """Many sources, so that every sector has some."""
    experiment = small_experiment(n_sources=4000)
    return experiment, small_scene(experiment)


def test_contract() -> None:
    experiment, scene = wide_scene()
    effect = Horizon()
    x = effect.draw(experiment, generator(1, "horizon"), 0.3)
    check_zero_is_nothing(effect, scene)
    check_derivative(effect, scene, x)
    check_adjoint(effect, scene, x)
    sigma = 0.01 * float(np.abs(effect.added(scene, x)).max())
    check_recovery(effect, scene, x, sigma=sigma)


def test_every_parameter_may_be_at_fault_by_itself() -> None:
    parameters = Horizon().parameters(small_experiment())
    assert len(parameters) == RINGS * (1 + SECTORS) == 130
    assert len(set(parameters.names)) == 130
    assert parameters.element.tolist() == list(range(130))
    assert parameters.trials == 130


def test_nothing_is_lost_twice() -> None:
    experiment = small_experiment()
    for strength in (0.1, 1.0, 10.0):
        x = Horizon().draw(experiment, generator(2, "horizon"), strength)
        assert (x <= 0).all()
        assert (x < 0).any()
        transmission = 1 + x[:RINGS, np.newaxis] + x[RINGS:].reshape(RINGS, SECTORS)
        assert (transmission >= -1e-15).all()


class Behind:
    """Positions from which the ground hides all below an elevation in a stretch of azimuth, degrees."""

    def __init__(self, positions: SourcePositions, below: float, az: tuple[float, float]) -> None:
        self.positions, self.below, self.az = positions, np.deg2rad(below), np.deg2rad(az)

    def above_horizon(self, itime: int) -> tuple[IntArray, FloatArray, FloatArray]:
        index, za, az = self.positions.above_horizon(itime)
        seen = (np.pi / 2 - za >= self.below) | (az < self.az[0]) | (az >= self.az[1])
        return index[seen], za[seen], az[seen]


@pytest.mark.parametrize(
    ("below", "az", "where"),
    [
        (10, (60, 120), ["az 60-90 deg", "az 90-120 deg"]),
        (5, (330, 361), ["az 330-360 deg"]),
        (10, (0, 361), ["all azimuths"]),
        (2, (0, 361), ["all azimuths"]),
    ],
)
def test_hidden_sky_equals_fewer_sources(below: float, az: tuple[float, float], where: list[str]) -> None:
    experiment, scene = wide_scene()
    effect = Horizon()
    scene.integrate_for([effect])
    rings = [f"elevation {lo:g}-{hi:g} deg" for lo, hi in pairwise(EDGES) if hi <= below]
    hidden = {f"{ring}, {azimuth}" for ring in rings for azimuth in where}
    x = np.array([-1.0 if name in hidden else 0.0 for name in effect.parameters(experiment).names])
    assert -x.sum() == len(rings) * len(where) > 0
    behind = replace(scene, positions=Behind(scene.positions, below, az))
    expected = scene.spread(behind.integrate(lambda sources: sources.beam[np.newaxis])[..., 0])
    largest = np.abs(scene.vis).max()
    assert np.abs(expected - scene.vis).max() > 1e-4 * largest
    np.testing.assert_allclose(scene.vis + effect.added(scene, x), expected, rtol=0, atol=1e-12 * largest)


def test_edges() -> None:
    za = np.deg2rad([79.999, 80.001, 85.001, 90.0, 84.999, 88.5])
    az = np.deg2rad([10.0, 359.999, 30.001, 360.0, 29.999, 180.0])
    za[3], az[3] = np.pi / 2, 2 * np.pi
    sources = Sources(np.arange(6), za, az, np.ones(6), lambda za, az: np.full(len(za), 2.0), 0.0)
    columns = Horizon().sky_columns(sources)
    assert columns.shape == (120, 6)
    rows, which = np.nonzero(columns)
    found = dict(zip(which.tolist(), rows.tolist(), strict=True))
    assert found == {1: 9 * 12 + 11, 2: 7 * 12 + 1, 3: 0, 4: 8 * 12, 5: 3 * 12 + 6}
    assert (columns[rows, which] == 2.0).all()
