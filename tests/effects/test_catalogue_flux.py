from dataclasses import replace

import numpy as np
import pytest

from hydrabeam_mpi.effects.catalogue_flux import CatalogueFlux
from hydrabeam_mpi.effects.experiment import Experiment
from hydrabeam_mpi.effects.horizon import Horizon
from hydrabeam_mpi.effects.point_sources import resolution
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.model.sky import Sky, separation
from hydrabeam_mpi.random import generator
from tests.effects.small import small_experiment, small_scene


def pinned(experiment: Experiment, index: list[int]) -> CatalogueFlux:
    sky = experiment.sky
    return CatalogueFlux(np.rad2deg([sky.ra[index], sky.dec[index]]).T.tolist())


def test_equals_another_catalogue() -> None:
    experiment = small_experiment()
    index = [4, 17, 42]
    np.testing.assert_allclose(np.abs(pinned(experiment, index).draw(experiment, generator(1, "flux"), 2.0)), 0.2)
    x = np.array([0.3, -0.2, 0.5])
    flux = experiment.sky.flux.copy()
    flux[:, index] *= 1 + x
    for channel in (0, 1):
        scene = small_scene(experiment, channel)
        other = small_scene(experiment, channel, sky=replace(experiment.sky, flux=flux))
        added = pinned(experiment, index).added(scene, x)
        np.testing.assert_allclose(scene.vis + added, other.vis, rtol=0, atol=1e-11 * np.abs(scene.vis).max())


def test_scan_finds_the_source() -> None:
    experiment = small_experiment()
    scene = small_scene(experiment)
    truth = CatalogueFlux().drawn(experiment, generator(2, "pick"))
    scene.residual = truth.added(scene, truth.draw(experiment, generator(3, "draw"), 1.0))
    effect = CatalogueFlux()
    projection, power = effect.scan(scene)
    score = projection[:, 0] ** 2 / np.maximum(power[:, 0], 1e-9 * power.max())
    best_first = effect.at(experiment, np.argsort(-score))
    np.testing.assert_allclose(best_first.sources[0], truth.sources[0], rtol=0, atol=1e-10)
    assert len(best_first.sources) == 40
    assert best_first.parameters(experiment).trials == 60


def test_sources_too_close_to_tell_apart() -> None:
    experiment = small_experiment()
    sky = experiment.sky
    close = Sky(
        np.append(sky.ra, sky.ra[:2]),
        np.append(sky.dec, sky.dec[:2] + np.array([0.05, 0.2]) * resolution(experiment)),
        np.concatenate([sky.flux, sky.flux[:, :2]], axis=1),
    )
    effect = CatalogueFlux().at(replace(experiment, sky=close), np.array([60, 0, 61, 1]))
    np.testing.assert_allclose(np.deg2rad(effect.sources), np.stack([close.ra, close.dec], 1)[[60, 61, 1]], rtol=1e-12)
    ra, dec = np.deg2rad(effect.sources).T
    assert separation(ra[0], dec[0], sky.ra[0], sky.dec[0]) > 0


def test_only_the_brightest_of_many() -> None:
    experiment = small_experiment()
    rng = generator(11, "many")
    n = 20_500
    flux = np.exp(rng.standard_normal(n))
    many = Sky(rng.uniform(0, 2 * np.pi, n), np.arcsin(rng.uniform(-1, 1, n)), np.stack([flux, flux]))
    experiment = replace(experiment, sky=many)
    effect = CatalogueFlux()
    assert effect.n_hypotheses(experiment) == 20_000
    everything = [effect.at(experiment, np.array([i])).sources[0] for i in (0, 19_999)]
    kept = np.flatnonzero(flux >= np.sort(flux)[500])
    np.testing.assert_allclose(np.deg2rad(everything), np.stack([many.ra, many.dec], 1)[kept[[0, -1]]], rtol=1e-12)


def test_names_and_unknown_sources() -> None:
    experiment = small_experiment()
    named = replace(experiment, sky=replace(experiment.sky, names=("", "Fornax A", *("",) * 58)))
    names = pinned(experiment, [0, 1]).parameters(named).names
    assert names[1] == "Fornax A: relative flux error"
    assert names[0].startswith(f"source ra={np.rad2deg(experiment.sky.ra[0]):.3f} dec=")
    with pytest.raises(InputError, match="no source at"):
        CatalogueFlux([(1.0, 2.0)]).parameters(experiment)


def test_sources_behind_a_wall() -> None:
    """What is hidden has no flux to be wrong about."""
    experiment = small_experiment()
    scene = small_scene(experiment)
    effect = pinned(experiment, list(range(experiment.sky.Nsrc)))
    x = np.full(experiment.sky.Nsrc, 0.1)
    behind = replace(scene, sky_effects=[(Horizon([(0, 360, 0, 10)]), np.array([-0.4]))])
    expected = 0.1 * behind.spread(behind.integrate(lambda sources: sources.beam[np.newaxis])[..., 0])
    largest = np.abs(scene.vis).max()
    np.testing.assert_allclose(effect.added(behind, x), expected, rtol=0, atol=1e-12 * largest)
    assert np.abs(effect.added(scene, x) - expected).max() > 1e-6 * largest
