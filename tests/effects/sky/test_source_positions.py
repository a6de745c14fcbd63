from dataclasses import replace

import numpy as np

from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.shared.point_sources import resolution
from hydrabeam_mpi.effects.sky.catalogue_flux import CatalogueFlux
from hydrabeam_mpi.effects.sky.source_positions import SourcePositions
from hydrabeam_mpi.model.sky import separation
from hydrabeam_mpi.random import generator
from tests.effects.small import small_block, small_setup

INDEX = [4, 17, 42]
X = np.array([[0.3, 7.0, -20.0], [-0.2, 0.0, 0.0], [0.0, -3.0, 90.0]])
"""Relative flux errors, and offsets East and North in arcmin."""


def pinned(setup: ObservingSetup) -> SourcePositions:
    return SourcePositions(np.rad2deg([setup.sky.ra[INDEX], setup.sky.dec[INDEX]]).T.tolist())


def moved(setup: ObservingSetup) -> ObservingSetup:
    """Return the setup with another catalogue, whose sources are where they have been displaced to."""
    sky = setup.sky
    ra, dec, flux = sky.ra.copy(), sky.dec.copy(), sky.flux.copy()
    for i, (error, east, north) in zip(INDEX, X, strict=True):
        here = np.array([np.cos(dec[i]) * np.cos(ra[i]), np.cos(dec[i]) * np.sin(ra[i]), np.sin(dec[i])])
        to_east = np.cross([0, 0, 1], here) / np.cos(dec[i])
        there = here + np.deg2rad(east / 60) * to_east + np.deg2rad(north / 60) * np.cross(here, to_east)
        ra[i], dec[i] = np.arctan2(there[1], there[0]), np.arcsin(there[2] / np.linalg.norm(there))
        flux[:, i] *= 1 + error
    return replace(setup, sky=replace(sky, ra=ra, dec=dec, flux=flux))


def test_equals_another_catalogue() -> None:
    setup = small_setup()
    there = moved(setup)
    apart = np.rad2deg(separation(setup.sky.ra, setup.sky.dec, there.sky.ra, there.sky.dec)) * 60
    np.testing.assert_allclose(apart[INDEX], np.hypot(X[:, 1], X[:, 2]), rtol=1e-3, atol=1e-5)
    for channel in (0, 1):
        block, other = small_block(setup, channel), small_block(setup, channel, sky=there.sky)
        added = pinned(setup).added(block, X.ravel())
        largest = np.abs(block.vis).max()
        np.testing.assert_allclose(block.vis + added, other.vis, rtol=0, atol=1e-11 * largest)
        assert np.abs(added).max() > 0.01 * largest


def test_as_part_of_the_sky() -> None:
    """What the beam sees of the sources where they are, less what it sees of them in the catalogue, is all of it."""
    setup = small_setup()
    block, effect = small_block(setup), pinned(setup)
    changed = replace(block, sky_effects=[(effect, X.ravel())])
    seen = changed.spread(changed.integrate(lambda sources: sources.beam[np.newaxis])[..., 0])
    other = small_block(setup, sky=moved(setup).sky)
    np.testing.assert_allclose(seen, other.vis, rtol=0, atol=1e-11 * np.abs(block.vis).max())


def test_beside_a_wrong_flux() -> None:
    """The flux that another effect gives a source is that which is displaced."""
    setup = small_setup()
    effect, flux = pinned(setup), CatalogueFlux(pinned(setup).sources)
    block = replace(small_block(setup), sky_effects=[(flux, np.array([1.0, 2.0, -0.5]))])
    brighter = replace(setup.sky, flux=setup.sky.flux.copy())
    brighter.flux[:, INDEX] *= [2.0, 3.0, 0.5]
    twice = small_block(replace(setup, sky=brighter))
    largest = np.abs(block.vis).max()
    np.testing.assert_allclose(
        effect.added(block, X.ravel()), effect.added(twice, X.ravel()), rtol=0, atol=1e-12 * largest
    )
    columns, expected = (effect.columns(one, X.ravel()).values for one in (block, twice))
    np.testing.assert_allclose(columns, expected, rtol=0, atol=1e-12 * largest)


def test_what_is_in_its_place_is_left_to_others() -> None:
    """One that it may displace, but does not: an error of its flux is seen, as if it were none of the sources."""
    setup = small_setup()
    flux, x = CatalogueFlux(pinned(setup).sources), X.copy()
    x[1] = 0.0
    block = replace(small_block(setup), sky_effects=[(pinned(setup), x.ravel())])
    columns = flux.columns(block, np.zeros(len(INDEX))).values
    expected = flux.columns(small_block(setup), np.zeros(len(INDEX))).values
    np.testing.assert_allclose(columns[..., 1], expected[..., 1], rtol=0, atol=1e-12 * np.abs(expected).max())
    assert np.all(columns[..., [0, 2]] == 0)
    assert np.abs(expected[..., 1]).max() > 0


def test_no_flux_is_below_zero() -> None:
    setup = small_setup()
    x, std = np.array([[-1.5, 3.0, 4.0, 0.1, -7.0, 8.0, -1.0, 0.0, 0.0]]), np.full((1, 9), 0.1)
    beyond = pinned(setup).beyond(setup, x, std)
    np.testing.assert_allclose(beyond, [5, 0, 0, 0, 0, 0, 0, 0, 0])
    assert pinned(setup).without(beyond > 0)[0].sources == pinned(setup).sources[1:]


def test_scan_finds_the_source() -> None:
    setup = small_setup()
    block, effect = small_block(setup), SourcePositions()
    truth = SourcePositions(effect.foremost(setup, 1).sources)
    block = replace(block, residual=truth.added(block, truth.draw(setup, generator(3, "draw"), 1.0)))
    projection, power = effect.scan(block)
    drop = np.sum(projection**2 / np.maximum(power, 1e-9 * power.max(axis=0)), axis=1)
    np.testing.assert_allclose(effect.at(setup, np.argsort(-drop)).sources[0], truth.sources[0], rtol=0, atol=1e-10)


def test_no_source_is_further_away_than_the_array_resolves() -> None:
    setup = small_setup()
    limit = np.rad2deg(resolution(setup)) * 60
    along = np.array([0.6, 0.8])
    x = np.array([[0.0, *(limit + 3.0) * along, 0.0, *0.9 * limit * along, 0.0, 0.0, -2 * limit]])
    std = np.full((1, 9), 1.0)
    std[:, 6:] = limit / 4
    beyond = pinned(setup).beyond(setup, x, std)
    np.testing.assert_allclose(beyond, [0, 3, 3, 0, 0, 0, 0, 4, 4])


def test_sources_that_may_be_at_their_places_are_wrong_fluxes() -> None:
    """As far as an offset is smaller than its error makes likely; not where it is not known at all."""
    setup = small_setup()
    limit = np.rad2deg(resolution(setup)) * 60
    x = np.array([[0.3, 0.5, -0.5, 0.2, 20.0, 0.0, -0.1, 0.0, 0.0]])
    std = np.array([[0.01, 1.0, 1.0, 0.01, 1.0, 1.0, 0.01, limit, limit]])
    ((which, effect, errors),) = pinned(setup).simpler_elements(setup, x, std)
    assert isinstance(effect, CatalogueFlux)
    assert effect.sources == pinned(setup).sources[:1]
    np.testing.assert_array_equal(which, np.arange(9) < 3)
    np.testing.assert_array_equal(errors, [0.3])
    std[:, :3] = 0.0
    assert pinned(setup).simpler_elements(setup, x, std) == []
