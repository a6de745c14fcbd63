from dataclasses import replace

import numpy as np
import pytest

from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.shared.point_sources import resolution
from hydrabeam_mpi.effects.sky.catalogue_flux import CatalogueFlux
from hydrabeam_mpi.effects.sky.horizon import Horizon
from hydrabeam_mpi.effects.sky.polarised_sources import PolarisedSources
from hydrabeam_mpi.effects.sky.resolved_source import ResolvedSource
from hydrabeam_mpi.effects.sky.source_positions import SourcePositions
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.model.sky import Sky, separation
from hydrabeam_mpi.random import generator
from tests.effects.small import small_block, small_setup


def pinned(setup: ObservingSetup, index: list[int]) -> CatalogueFlux:
    sky = setup.sky
    return CatalogueFlux(np.rad2deg([sky.ra[index], sky.dec[index]]).T.tolist())


def test_equals_another_catalogue() -> None:
    setup = small_setup()
    index = [4, 17, 42]
    np.testing.assert_allclose(np.abs(pinned(setup, index).draw(setup, generator(1, "flux"), 2.0)), 0.2)
    x = np.array([0.3, -0.2, 0.5])
    flux = setup.sky.flux.copy()
    flux[:, index] *= 1 + x
    for channel in (0, 1):
        block = small_block(setup, channel)
        other = small_block(setup, channel, sky=replace(setup.sky, flux=flux))
        added = pinned(setup, index).added(block, x)
        np.testing.assert_allclose(block.vis + added, other.vis, rtol=0, atol=1e-11 * np.abs(block.vis).max())


def test_scan_finds_the_source() -> None:
    setup = small_setup()
    block = small_block(setup)
    truth = CatalogueFlux().drawn(setup, generator(2, "pick"))
    block = replace(block, residual=truth.added(block, truth.draw(setup, generator(3, "draw"), 1.0)))
    effect = CatalogueFlux()
    projection, power = effect.scan(block)
    score = projection[:, 0] ** 2 / np.maximum(power[:, 0], 1e-9 * power.max())
    best_first = effect.at(setup, np.argsort(-score))
    np.testing.assert_allclose(best_first.sources[0], truth.sources[0], rtol=0, atol=1e-10)
    assert len(best_first.sources) == 40
    assert best_first.parameters(setup).trials == 60


def test_sources_too_close_to_tell_apart() -> None:
    setup = small_setup()
    sky = setup.sky
    close = Sky(
        np.append(sky.ra, sky.ra[:2]),
        np.append(sky.dec, sky.dec[:2] + np.array([0.05, 0.2]) * resolution(setup)),
        np.concatenate([sky.flux, sky.flux[:, :2]], axis=1),
    )
    effect = CatalogueFlux().at(replace(setup, sky=close), np.array([60, 0, 61, 1]))
    np.testing.assert_allclose(np.deg2rad(effect.sources), np.stack([close.ra, close.dec], 1)[[60, 61, 1]], rtol=1e-12)
    ra, dec = np.deg2rad(effect.sources).T
    assert separation(ra[0], dec[0], sky.ra[0], sky.dec[0]) > 0


def many_sources(n: int) -> ObservingSetup:
    """All over the sky: half of them never rise, or pass where a dish sees next to nothing."""
    rng, setup = generator(11, "many"), small_setup(n_times=12)
    flux = np.exp(rng.standard_normal(n))
    sky = Sky(rng.uniform(0, 2 * np.pi, n), np.arcsin(rng.uniform(-1, 1, n)), np.stack([flux, flux]))
    return replace(setup, sky=sky)


def test_only_the_brightest_of_many() -> None:
    setup = many_sources(20_500)
    effect, sky = CatalogueFlux(), setup.sky
    assert effect.n_hypotheses(setup) == 20_000
    kept, up = effect.brightest(setup), np.zeros(20_500, dtype=bool)
    for itime in range(setup.observation.Ntimes):
        up[small_block(setup).positions.above_horizon(itime)[0]] = True
    # There are more that are never up, of which the faintest are left out.
    down = np.flatnonzero(~up)
    faintest = down[np.argsort(sky.flux[0, down])[:500]]
    np.testing.assert_array_equal(np.delete(np.arange(20_500), kept), np.sort(faintest))
    everything = [effect.at(setup, np.array([i])).sources[0] for i in (0, 19_999)]
    np.testing.assert_allclose(np.deg2rad(everything), np.stack([sky.ra, sky.dec], 1)[kept[[0, -1]]], rtol=1e-12)


@pytest.mark.parametrize("kind", [SourcePositions, ResolvedSource, PolarisedSources])
def test_they_are_those_that_the_array_sees_brightest(kind: type[CatalogueFlux]) -> None:
    """However bright others are in the catalogue; to the accuracy of a grid of one degree."""
    setup = many_sources(6000)
    block = small_block(setup, 1)
    seen = np.zeros(6000)
    for itime in range(setup.observation.Ntimes):
        index, za, az = block.positions.above_horizon(itime)
        seen[index] += (setup.sky.flux[1, index] * block.beam(za, az)) ** 2
    kept = kind().brightest(setup)
    assert len(kept) == kind.most
    brightest = np.argsort(-seen)
    assert np.isin(brightest[: int(0.8 * kind.most)], kept).all()
    assert np.delete(seen, kept).max() < 2 * np.sort(seen)[-kind.most]
    by_catalogue = np.argsort(-setup.sky.flux[1])[: kind.most]
    assert np.isin(by_catalogue, kept).mean() < 0.6


def test_names_and_unknown_sources() -> None:
    setup = small_setup()
    named = replace(setup, sky=replace(setup.sky, names=("", "Fornax A", *("",) * 58)))
    names = pinned(setup, [0, 1]).parameters(named).names
    assert names[1] == "Fornax A: relative flux error"
    assert names[0].startswith(f"source ra={np.rad2deg(setup.sky.ra[0]):.3f} dec=")
    with pytest.raises(InputError, match="no source at"):
        CatalogueFlux([(1.0, 2.0)]).parameters(setup)


def test_sources_behind_a_wall() -> None:
    """What is hidden has no flux to be wrong about."""
    setup = small_setup()
    block = small_block(setup)
    effect = pinned(setup, list(range(setup.sky.Nsrc)))
    x = np.full(setup.sky.Nsrc, 0.1)
    behind = replace(block, sky_effects=[(Horizon([(0, 360, 0, 10)]), np.array([-0.4]))])
    expected = 0.1 * behind.spread(behind.integrate(lambda sources: sources.beam[np.newaxis])[..., 0])
    largest = np.abs(block.vis).max()
    np.testing.assert_allclose(effect.added(behind, x), expected, rtol=0, atol=1e-12 * largest)
    assert np.abs(effect.added(block, x) - expected).max() > 1e-6 * largest
