from dataclasses import replace

import numpy as np
import pytest

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.experiment import Experiment
from hydrabeam_mpi.effects.missing_sources import MissingSources, candidates
from hydrabeam_mpi.effects.point_sources import resolution
from hydrabeam_mpi.effects.scene import Scene
from hydrabeam_mpi.model.positions import ApparentPositions
from hydrabeam_mpi.model.sky import Sky, concatenate, separation
from hydrabeam_mpi.random import complex_normal, generator
from tests.effects.small import (
    check_adjoint,
    check_derivative,
    check_recovery,
    check_zero_is_nothing,
    matrix_at,
    small_experiment,
    small_scene,
)


def two_sources(experiment: Experiment) -> MissingSources:
    ra, dec = candidates(experiment, np.deg2rad(70.0))
    return MissingSources(np.rad2deg([[ra[3], dec[3]], [ra[-3], dec[-3]]]).tolist())


@pytest.mark.parametrize("freqs", [(131e6,), (131e6, 151e6)])
def test_contract(freqs: tuple[float, ...]) -> None:
    experiment = small_experiment(freqs)
    scene = small_scene(experiment, channel=len(freqs) - 1)
    effect = two_sources(experiment)
    x = effect.draw(experiment, generator(1, "missing"), 20.0)
    assert len(x) == 2 * (3 if len(freqs) == 1 else 4)
    check_zero_is_nothing(effect, scene)
    check_derivative(effect, scene, x)
    check_adjoint(effect, scene, x)
    start = x * (np.arange(len(x)) % (len(x) // 2) == 0)
    check_recovery(effect, scene, x, sigma=0.01 * float(np.abs(scene.vis).max()), start=0.8 * start)


def test_equals_a_sky_with_the_source_in_it() -> None:
    """At both frequencies, by the offset's meaning on the sphere: east along increasing right ascension."""
    experiment = small_experiment()
    effect = two_sources(experiment)
    flux, east, north, change = 12.0, 0.4, -0.3, 0.25
    x = np.array([flux, east, north, change, 0, 0, 0, 0])
    ra, dec = np.deg2rad(effect.sources[0])
    offset = np.hypot(east, north)
    # Great circle at a position angle from north through east; tangent-plane radii are tangents.
    angle, towards = np.arctan(np.deg2rad(offset)), np.arctan2(east, north)
    moved_dec = np.arcsin(np.sin(dec) * np.cos(angle) + np.cos(dec) * np.sin(angle) * np.cos(towards))
    moved_ra = ra + np.arctan2(
        np.sin(towards) * np.sin(angle) * np.cos(dec), np.cos(angle) - np.sin(dec) * np.sin(moved_dec)
    )
    fluxes = flux * (experiment.observation.freqs / experiment.reference_freq) ** (-0.7 + change)
    extra = Sky(np.array([moved_ra]), np.array([moved_dec]), fluxes[:, np.newaxis])
    for channel in (0, 1):
        scene = small_scene(experiment, channel)
        with_it = small_scene(experiment, channel, sky=concatenate([experiment.sky, extra]))
        difference = with_it.vis - scene.vis
        assert np.abs(difference).max() > 0.01
        np.testing.assert_allclose(effect.added(scene, x), difference, rtol=0, atol=1e-9 * np.abs(with_it.vis).max())


def test_follows_the_rule_of_the_sky() -> None:
    experiment = small_experiment()
    scene = small_scene(experiment)
    scene.positions = ApparentPositions(experiment.sky, experiment.observation)
    effect = two_sources(experiment)
    x = np.array([10.0, 0.1, 0.2, 0.0, 0, 0, 0, 0])
    ra, dec = effect._places(x.reshape(2, 4))
    flux = 10.0 * (scene.freq / experiment.reference_freq) ** -0.7
    sky = Sky(ra[:1], dec[:1], np.full((2, 1), flux))
    positions = ApparentPositions(sky, experiment.observation)
    alone = replace(scene, experiment=replace(experiment, sky=sky), positions=positions)
    expected = scene.spread(alone.integrate(lambda sources: sources.beam[np.newaxis])[..., 0])
    np.testing.assert_allclose(effect.added(scene, x), expected, rtol=0, atol=1e-12 * np.abs(expected).max())
    check_derivative(effect, scene, x)


def flagged_scene(experiment: Experiment) -> Scene:
    scene = small_scene(experiment)
    rng = generator(4, "weights")
    scene.weights = rng.uniform(0.5, 2.0, scene.shape) * (rng.uniform(size=scene.shape) > 0.2)
    scene.weights[2] = 0.0
    scene.residual = complex_normal(rng, scene.shape)
    return scene


def test_scan_is_the_adjoint_of_the_columns() -> None:
    experiment = small_experiment()
    scene = flagged_scene(experiment)
    effect = MissingSources()
    ra, dec = candidates(experiment)
    projection, power = effect.scan(scene)
    assert projection.shape == power.shape == (effect.n_hypotheses(experiment), 1)
    some = generator(5, "some").choice(len(ra), 12, replace=False)
    pinned = MissingSources(np.rad2deg([ra[some], dec[some]]).T.tolist())
    columns = matrix_at(pinned, scene, np.zeros(48))[..., ::4]
    expected = np.einsum("tb,tbp,tb->p", scene.weights, columns.conj(), scene.residual).real
    expected_power = np.einsum("tb,tbp->p", scene.weights, np.abs(columns) ** 2)
    # The beam is interpolated in scans.
    np.testing.assert_allclose(power[some, 0], expected_power, rtol=0, atol=2e-3 * power.max())
    np.testing.assert_allclose(projection[some, 0], expected, rtol=0, atol=2e-3 * np.abs(projection).max())


def found(experiment: Experiment, residual_of: MissingSources, x: FloatArray) -> MissingSources:
    effect = MissingSources()
    totals = [np.zeros((effect.n_hypotheses(experiment), 1)) for _ in range(2)]
    for channel in range(experiment.observation.Nfreqs):
        scene = small_scene(experiment, channel)
        scene.residual = residual_of.added(scene, x)
        for total, part in zip(totals, effect.scan(scene), strict=True):
            total += part
    projection, power = totals
    score = np.maximum(projection, 0)[:, 0] ** 2 / np.maximum(power[:, 0], 1e-9 * power.max())
    return effect.at(experiment, np.argsort(-score))


def test_scan_finds_a_source_between_grid_points() -> None:
    experiment = small_experiment()
    truth = MissingSources().drawn(experiment, generator(6, "pick"))
    x = truth.draw(experiment, generator(7, "draw"), 5.0)
    effect = found(experiment, truth, x)
    (found_ra, found_dec), (ra, dec) = np.deg2rad(effect.sources[0]), truth._places(x.reshape(1, 4))
    assert separation(found_ra, found_dec, ra, dec) < 0.35 * resolution(experiment)
    ra, dec = np.deg2rad(effect.sources).T
    assert len(ra) == 20
    assert effect.trials >= 10
    apart = separation(ra[:, np.newaxis], dec[:, np.newaxis], ra, dec)[np.triu_indices(20, 1)]
    assert apart.min() > resolution(experiment)


def test_candidates_are_the_points_that_rise() -> None:
    experiment = small_experiment()
    ra, dec = candidates(experiment)
    observation = experiment.observation
    lat = float(observation.location.lat.rad)
    lsts = observation.lsts[:, np.newaxis]
    za = separation(ra, dec, lsts, lat)
    assert za.min(axis=0).max() <= np.deg2rad(85.0)
    # What is missing is what does not rise: the sky that does rise is covered evenly.
    rng = generator(8, "sky")
    any_ra, any_dec = rng.uniform(0, 2 * np.pi, 500), np.arcsin(rng.uniform(-1, 1, 500))
    up = separation(any_ra, any_dec, lsts, lat).min(axis=0) < np.deg2rad(80)
    nearest = separation(ra, dec, any_ra[up, np.newaxis], any_dec[up, np.newaxis]).min(axis=1)
    assert nearest.max() < 0.35 * resolution(experiment)


def test_no_sources_and_restored_ones() -> None:
    experiment = small_experiment()
    scene = small_scene(experiment)
    empty = MissingSources()
    assert len(empty.parameters(experiment)) == 0
    assert not empty.added(scene, np.zeros(0)).any()
    assert empty.columns(scene, np.zeros(0)).values.shape[2] == 0
    pinned = two_sources(experiment)
    x = pinned.draw(experiment, generator(9, "draw"), 3.0)
    again = MissingSources(**pinned.describe())
    np.testing.assert_array_equal(again.added(scene, x), pinned.added(scene, x))
    parameters = pinned.parameters(experiment)
    assert parameters.element.tolist() == [0] * 4 + [1] * 4
    assert parameters.refined.tolist() == [False, True, True, True] * 2
