from dataclasses import replace

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray, IntArray
from hydrabeam_mpi.effects.horizon import Horizon
from hydrabeam_mpi.effects.scene import Experiment, Scene, Sources
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
    x = effect.draw(experiment, generator(1, "horizon"), 1.0)
    assert (x <= 0).all()
    assert (x >= -1).all()
    check_zero_is_nothing(effect, scene)
    check_derivative(effect, scene, x)
    check_adjoint(effect, scene, x)
    sigma = 0.01 * float(np.abs(effect.added(scene, x)).max())
    check_recovery(effect, scene, x, sigma=sigma)


class Behind:
    """Positions from which a hill hides a stretch of the horizon."""

    def __init__(self, positions: SourcePositions, above: float, az: tuple[float, float]) -> None:
        self.positions, self.above, self.az = positions, np.deg2rad(above), np.deg2rad(az)

    def above_horizon(self, itime: int) -> tuple[IntArray, FloatArray, FloatArray]:
        index, za, az = self.positions.above_horizon(itime)
        seen = (za < self.above) | (az < self.az[0]) | (az >= self.az[1])
        return index[seen], za[seen], az[seen]


def test_hidden_sectors_equal_fewer_sources() -> None:
    experiment, scene = wide_scene()
    effect = Horizon()
    scene.integrate_for([effect])
    names = effect.parameters(experiment).names
    for above, az, hidden in (
        (80, (60, 120), ["za 80-85 deg, az 60-90", "za 80-85 deg, az 90-120", "za 85-90 deg, az 60-90"]),
        (85, (330, 361), ["za 85-90 deg, az 330-360"]),
    ):
        if above == 80:
            hidden = [*hidden, "za 85-90 deg, az 90-120"]
        x = np.array([-1.0 if any(name.startswith(start) for start in hidden) else 0.0 for name in names])
        assert -x.sum() == len(hidden)
        behind = replace(scene, positions=Behind(scene.positions, above, az))
        expected = scene.spread(behind.integrate(lambda sources: sources.beam[np.newaxis])[..., 0])
        assert np.abs(expected - scene.vis).max() > 1e-4 * np.abs(scene.vis).max()
        np.testing.assert_allclose(
            scene.vis + effect.added(scene, x), expected, rtol=0, atol=1e-12 * np.abs(scene.vis).max()
        )


def test_edges() -> None:
    za = np.deg2rad([79.999, 80.001, 85.001, 90.0, 84.999])
    az = np.deg2rad([10.0, 359.999, 30.001, 360.0, 29.999])
    za[3], az[3] = np.pi / 2, 2 * np.pi
    sources = Sources(np.arange(5), za, az, np.ones(5), lambda za, az: np.full(len(za), 2.0), 0.0)
    columns = Horizon().sky_columns(sources)
    assert columns.shape == (24, 5)
    rows, which = np.nonzero(columns)
    assert dict(zip(which.tolist(), rows.tolist(), strict=True)) == {1: 11, 2: 13, 3: 12, 4: 0}
    assert (columns[rows, which] == 2.0).all()
