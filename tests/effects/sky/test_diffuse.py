from dataclasses import replace

import numpy as np
import pytest
from scipy.special import sph_harm_y

from hydrabeam_mpi.data.observation import C_M_PER_S, FloatArray
from hydrabeam_mpi.effects.interface import skies_on_rings
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.sky import diffuse
from hydrabeam_mpi.effects.sky.diffuse import Diffuse, harmonics
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.model.positions import ApparentPositions, RotatedPositions
from hydrabeam_mpi.model.sky import Sky
from hydrabeam_mpi.random import generator
from tests.effects.small import small_block, small_setup


def complex_harmonics(l_max: int, z: FloatArray, azimuth: FloatArray) -> FloatArray:
    """Real orthonormal harmonics from scipy's complex ones."""
    rows = []
    for l in range(l_max + 1):
        for m in range(-l, l + 1):
            value = (-1) ** m * sph_harm_y(l, abs(m), np.arccos(z), azimuth)
            rows.append(value.real if m == 0 else np.sqrt(2) * (value.imag if m < 0 else value.real))
    return np.array(rows)


def test_harmonics_are_scipys() -> None:
    rng = generator(2, "points")
    z, azimuth = rng.uniform(-1, 1, 50), rng.uniform(-np.pi, np.pi, 50)
    expected = complex_harmonics(6, z, azimuth)
    np.testing.assert_allclose(harmonics(6, z, azimuth), expected, rtol=0, atol=1e-13)
    grid = harmonics(6, z[:, np.newaxis], azimuth)
    np.testing.assert_allclose(np.diagonal(grid, axis1=1, axis2=2), expected, rtol=0, atol=1e-13)


def uniform(block: RowBlock, length: float, freq: float) -> RowBlock:
    """The scene with a beam of one and all baselines of a length, at random directions in the plane."""
    observation = replace(block.setup.observation, freqs=np.array([freq]))
    angles = generator(3, "angles").uniform(0, 2 * np.pi, len(block.groups))
    vectors = length * np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=1)
    redundant = replace(block.setup.redundant, vectors=vectors)
    setup = replace(block.setup, observation=observation, redundant=redundant)
    return replace(block, setup=setup, channel=0, beam=lambda za, az: np.ones(len(za)))


@pytest.mark.parametrize("length", [3.0, 30.0, 149.0])
def test_monopole_under_a_uniform_beam(length: float) -> None:
    """1/2 a_00 Y_00 times a fringe's integral over the hemisphere, 2 pi sin(kb)/(kb) for baselines in its plane."""
    block = uniform(small_block(small_setup((131e6,))), length, 200e6)
    phase = 2 * np.pi * 200e6 / C_M_PER_S * length
    expected = 0.5 / np.sqrt(4 * np.pi) * 2 * np.pi * np.sin(phase) / phase
    values = Diffuse().columns(block, np.zeros(49)).values
    np.testing.assert_allclose(values[..., 0].real, expected, rtol=0, atol=1e-10)


def test_long_baselines_see_nothing() -> None:
    block = uniform(small_block(small_setup((131e6,))), 151.0, 200e6)
    assert not Diffuse().columns(block, np.zeros(49)).values.any()
    reason = Diffuse().not_applicable(block.setup)
    assert reason is not None
    assert "baselines below 150 m" in reason
    assert Diffuse().not_applicable(small_setup()) is None


def points_of(setup: ObservingSetup, x: FloatArray, n: int = 240) -> Sky:
    """The diffuse sky as sources on rings of equal declination, with the weights of Gauss and Legendre as areas."""
    nodes, weights = np.polynomial.legendre.leggauss(n)
    z, ra = np.repeat(nodes, 2 * n), np.tile(np.pi / n * np.arange(2 * n), n)
    flux = (x @ complex_harmonics(6, z, ra)) * np.repeat(weights, 2 * n) * np.pi / n
    return Sky(ra, np.arcsin(z), np.stack([flux] * setup.observation.Nfreqs))


@pytest.mark.parametrize(("rule", "rtol"), [(RotatedPositions, 1e-8), (ApparentPositions, 3e-4)])
def test_equals_a_sky_of_points(rule: type[RotatedPositions | ApparentPositions], rtol: float) -> None:
    """With a beam that ends smoothly at the horizon, which cuts between points; aberration moves them by 1e-4 rad."""
    setup = small_setup()
    block = small_block(setup, channel=1)
    block = replace(block, positions=rule(setup.sky, setup.observation))
    full = block.beam
    block = replace(block, beam=lambda za, az: full(za, az) * np.cos(za) ** 6)
    effect = Diffuse()
    x = effect.draw(setup, generator(4, "diffuse"), 1.0)
    sky = points_of(setup, x)
    some = replace(block, times=block.times[[1, 4]], setup=replace(setup, sky=sky))
    some = replace(some, positions=rule(sky, setup.observation))
    expected = some.spread(some.integrate(lambda sources: sources.beam[np.newaxis])[..., 0])
    added = effect.added(block, x)[[1, 4]]
    np.testing.assert_allclose(added, expected, rtol=0, atol=rtol * np.abs(expected).max())


def test_quadrature_has_converged(monkeypatch: pytest.MonkeyPatch) -> None:
    """With a real beam, up to the longest baselines: more points change nothing."""
    setup = small_setup()
    block = small_block(setup, channel=1)
    longest = np.linalg.norm(block.vectors, axis=1).max()
    stretched = replace(setup.redundant, vectors=setup.redundant.vectors * (198.0 / longest))
    block = replace(block, setup=replace(setup, redundant=stretched))
    values = Diffuse().columns(block, np.zeros(49)).values
    monkeypatch.setattr(diffuse, "BEAM_NODES", diffuse.BEAM_NODES + 60)
    monkeypatch.setattr(diffuse, "BEAM_ORDERS", diffuse.BEAM_ORDERS + 60)
    finer = Diffuse().columns(block, np.zeros(49)).values
    assert np.abs(finer - values).max() > 0
    np.testing.assert_allclose(values, finer, rtol=0, atol=1e-6 * np.abs(finer).max())


def test_the_prior_is_of_galactic_emission() -> None:
    """Power falls as l^-2.5, and two rms below the mean nothing is negative."""
    scale = Diffuse(6).parameters(small_setup()).scale
    by_degree = np.split(scale, np.arange(1, 7) ** 2)
    for l, sizes in enumerate(by_degree[1:], start=1):
        np.testing.assert_allclose(sizes**2, by_degree[1][0] ** 2 * l**-2.5, rtol=1e-12)
    assert len(by_degree[0]) == 1
    np.testing.assert_allclose(scale[0], 2 * np.sqrt(np.sum(scale[1:] ** 2)), rtol=0.05)


def test_degrees_come_in_batches() -> None:
    """Those that come next have the visibilities that all have at once, and no harmonic is left out or twice."""
    setup = small_setup()
    block, all_degrees = small_block(setup, channel=1), Diffuse(9)
    following = Diffuse(9, l_min=5)
    names = [*Diffuse(4).parameters(setup).names, *following.parameters(setup).names]
    assert names == list(all_degrees.parameters(setup).names)
    values = all_degrees.columns(block, np.zeros(100)).values[..., 25:]
    np.testing.assert_allclose(following.columns(block, np.zeros(75)).values, values, rtol=0, atol=1e-12)
    x = generator(5, "diffuse").standard_normal(75)
    padded = np.concatenate([np.zeros(25), x])
    sky, of_all = (one.extra_sky(block, 2, at) for one, at in ((following, x), (all_degrees, padded)))
    np.testing.assert_allclose(sky[2], of_all[2], rtol=0, atol=1e-12 * np.abs(sky[2]).max())
    numbers = following.standing_numbers(block, 2, x)
    skies = following.standing_skies(block)
    fluxes = skies.across[:, :, np.newaxis] * skies.along[skies.function][:, np.newaxis]
    standing = np.tensordot(numbers, fluxes, axes=1).ravel()
    np.testing.assert_allclose(sky[2], standing, rtol=0, atol=1e-10 * np.abs(sky[2]).max())


def test_the_design_of_skies_on_rings_is_that_of_their_points(monkeypatch: pytest.MonkeyPatch) -> None:
    """A few rings at a time, of which the last are fewer."""
    block = small_block(small_setup(), channel=1)
    basis, engine, skies = block.setup.basis, block.engine, Diffuse(4, l_min=2).standing_skies(block)
    fluxes = (skies.across[:, :, np.newaxis] * skies.along[skies.function][:, np.newaxis]).reshape(
        len(skies.across), -1
    )
    za, az = (one.ravel() for one in np.broadcast_arrays(skies.za[:, np.newaxis], skies.az))
    expected = engine.design(basis, za, az, fluxes, np.full(len(fluxes), block.freq))
    bytes_of_ring = 8 * len(skies.along) * 2 * engine.n_vectors * basis.n_columns
    monkeypatch.setattr(skies_on_rings, "AT_ONCE_BYTES", 7 * bytes_of_ring)
    assert len(skies.za) % 7
    found = skies.design(engine, basis, block.freq)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_what_comes_next() -> None:
    """As many harmonics as halves of the data can be asked for, until there are no more degrees."""
    setup, newest = small_setup(), Diffuse()
    assert [one.l_max for one in newest.larger(setup)] == [12, 21]
    newest = newest.larger(setup)[-1]
    following = Diffuse().next_after(setup, newest)
    assert following.describe() == {"l_max": 30, "l_min": 22}
    assert following.larger(setup) == []
    while newest.describe() != (following := Diffuse().next_after(setup, newest)).describe() and following.l_min:
        assert following.l_min == newest.l_max + 1
        assert len(following.parameters(setup)) <= diffuse.MOST_HARMONICS
        newest = following
    assert newest.l_max == diffuse.MOST_DEGREES
    with pytest.raises(InputError, match="less than l_min"):
        Diffuse(3, l_min=4)
