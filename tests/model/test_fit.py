"""Fits of beams whose coefficients are known, on every kind of grid."""

import numpy as np
import pytest
from astropy_healpix import HEALPix

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.model.bases.fourier_bessel import FourierBessel, radial_zeros
from hydrabeam_mpi.model.bases.rest import Rest, rest_nodes
from hydrabeam_mpi.model.bases.rings import Pixels, RingGrid, degree_grid
from hydrabeam_mpi.model.bases.with_rest import WithRest
from hydrabeam_mpi.model.bases.zernike import Zernike
from hydrabeam_mpi.model.beam import BeamInfo, CoefficientBeam, analytic_beam
from hydrabeam_mpi.model.fit import beam_pixels, fit_basis, fit_beam, fit_several
from hydrabeam_mpi.random import generator


def healpix(nside, order="ring"):
    lon, lat = HEALPix(nside, order).healpix_to_lonlat(np.arange(12 * nside**2))
    za = np.pi / 2 - lat.value
    return za[za < np.pi / 2 + 1e-9], lon.value[za < np.pi / 2 + 1e-9]


def shuffled(za, az):
    order = generator(1, "shuffle", len(za)).permutation(len(za))
    return za[order], az[order]


def scattered(n):
    rng = generator(1, "scattered")
    return np.arccos(rng.uniform(0, 1, n)), rng.uniform(0, 2 * np.pi, n)


def degree_grid_from(start):
    za, az = degree_grid()
    return za, az + start


def closed_circle():
    az, za = np.meshgrid(np.linspace(0, 2 * np.pi, 73), np.linspace(0, np.pi / 2, 31))
    return za.ravel(), az.ravel()


def uneven():
    """Azimuths that leave half a step between the last and the first."""
    az, za = np.meshgrid(np.linspace(0, np.deg2rad(359), 90), np.linspace(0, np.pi / 2, 46))
    return za.ravel(), az.ravel()


GRIDS = {
    "1 degree": degree_grid(),
    "azimuth from -3": degree_grid_from(-3.0),
    "closed circle": closed_circle(),
    "HEALPix": healpix(32),
    "HEALPix nested": healpix(32, "nested"),
    "any order": shuffled(*healpix(32)),
    "uneven azimuths": uneven(),
    "scattered": scattered(3000),
}


def random_beam(basis, *key):
    """Coefficients of a beam that does not depend on azimuth at the zenith."""
    rng = generator(4, *key)
    coeffs = np.array([np.exp(-k / 3 - abs(m)) for k, m in basis.modes]) * rng.standard_normal(basis.n_modes)
    if basis.is_complex:
        coeffs = coeffs * np.exp(1j * rng.uniform(0, 6, basis.n_modes))
    m = np.array([m for _, m in basis.modes])
    _, q = radial_zeros(max(k for k, _ in basis.modes), basis.boundary)
    at_zenith = np.array([1 / q[k - 1] for k, _ in basis.modes])
    for order in set(m[m != 0]):
        first = next(n for n, mode in enumerate(basis.modes) if mode == (1, order))
        coeffs[first] -= (coeffs * at_zenith)[m == order].sum() / at_zenith[first]
    return coeffs


@pytest.mark.parametrize("form", ["real", "complex"])
@pytest.mark.parametrize("grid", list(GRIDS))
def test_known_coefficients_are_found(grid, form):
    """Low orders only, so that even the first rings of a HEALPix map, of 4 and 8 pixels, carry them."""
    basis = FourierBessel.full(12, 1, form=form)
    truth = random_beam(basis, grid)
    za, az = GRIDS[grid]
    fit = fit_basis(basis, Pixels(za, az, basis.synthesize(truth, za, az)))
    np.testing.assert_allclose(fit.coeffs, truth, atol=1e-9)
    assert fit.max_residual < 1e-9
    assert fit.n_cut == 0
    assert fit.n_pixels == len(za)


@pytest.mark.parametrize("form", ["real", "complex"])
def test_rings_and_points_give_the_same_least_squares_solution(form):
    """For a beam that the basis cannot follow, so that the two could differ."""
    basis = FourierBessel.full(9, 4, form=form)
    za, az = closed_circle()
    kept = az < 2 * np.pi - 1e-6
    za, az = za[kept], az[kept]
    values = np.exp(-3 * za) * (1 + np.sin(za) * np.cos(az - 1)) + np.sin(5 * za) * np.cos(3 * az)
    if form == "complex":
        values = values + 0.2j * np.sin(za) * np.exp(2j * az)
    on_rings = fit_basis(basis, Pixels(za, az, values))
    design = basis.evaluate(za, az).T
    np.testing.assert_allclose(on_rings.coeffs, np.linalg.lstsq(design, values, rcond=None)[0], atol=1e-10)
    # A wobble of 1e-6 in zenith angle takes the rings apart, not the solution.
    wobble = za + 1e-6 * np.sin(1e4 * np.arange(len(za)))
    assert RingGrid.from_pixels(Pixels(wobble, az, values)) is None
    np.testing.assert_allclose(fit_basis(basis, Pixels(wobble, az, values)).coeffs, on_rings.coeffs, atol=1e-4)
    residual = np.abs(design @ on_rings.coeffs - values)
    assert on_rings.rms_residual == pytest.approx(np.sqrt(np.mean(residual**2)))
    assert on_rings.max_residual == pytest.approx(residual.max())


@pytest.mark.parametrize("kind", ["real", "complex", "with what is left"])
@pytest.mark.parametrize("grid", ["1 degree", "scattered"])
def test_several_beams_at_once_are_fitted_as_each_by_itself(grid, kind):
    basis = FourierBessel.full(9, 2, form="complex" if kind == "complex" else "real")
    if kind == "with what is left":
        basis = WithRest(basis, Rest(np.cos(7 * rest_nodes()[0])))
    za, az = GRIDS[grid]
    values = np.exp(-3 * za) * np.array([np.cos(az), np.sin(5 * za), np.ones_like(za)])
    if kind == "complex":
        values = values * np.exp(1j * az)
    found = fit_several(basis, Pixels(za, az, values[0]), values)
    expected = [fit_basis(basis, Pixels(za, az, one)).coeffs for one in values]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


def test_rings_are_told_from_scattered_points():
    for name, (za, az) in GRIDS.items():
        rings = RingGrid.from_pixels(Pixels(za, az, np.cos(za)))
        assert (rings is None) == (name == "scattered")
    half = np.meshgrid(np.linspace(0, np.pi, 90), np.linspace(0, 1.5, 10))
    assert RingGrid.from_pixels(Pixels(half[1].ravel(), half[0].ravel(), np.ones(900))) is None


def test_real_and_complex_form_are_the_same_fit():
    beam = analytic_beam("airy", 150e6, diameter=14.0)
    real = fit_beam(beam, FourierBessel.selection(200, "real", k_max=30, m_max=4))
    mixed = fit_beam(beam, FourierBessel.selection(200, "complex", k_max=30, m_max=4))
    assert real.rms_residual == pytest.approx(mixed.rms_residual, rel=1e-9)
    za, az = scattered(50)
    np.testing.assert_allclose(
        real.basis.synthesize(real.coeffs, za, az), mixed.basis.synthesize(mixed.coeffs, za, az), atol=1e-12
    )


def elliptic(za, az):
    """A smooth beam with all even orders, its axes along no ring's first azimuth."""
    x, y = np.sin(za) * np.cos(az - 0.4), np.sin(za) * np.sin(az - 0.4)
    return np.exp(-((x / 0.16) ** 2) - (y / 0.13) ** 2)


@pytest.mark.parametrize("nside", [32, 64])
def test_healpix_fit_is_smooth_between_the_few_pixels_at_the_zenith(nside):
    """All 7280 modes pass through four pixels in many ways; the fit must take the one that a beam takes."""
    za, az = healpix(nside)
    basis = FourierBessel.full(form="complex") if nside == 64 else FourierBessel.full(40, 45, form="complex")
    fit = fit_basis(basis, Pixels(za, az, elliptic(za, az)))
    assert fit.max_residual < 1e-5
    fine_za, fine_az = np.meshgrid(np.deg2rad(np.linspace(0, 6, 61)), np.linspace(0, 2 * np.pi, 181))
    fine = fine_za.ravel(), fine_az.ravel()
    error = np.abs(basis.synthesize(fit.coeffs, *fine) - elliptic(*fine))
    assert error.max() < 2e-5


def test_full_fit_on_the_degree_grid_follows_any_smooth_beam():
    za, az = degree_grid()
    fit = fit_basis(FourierBessel.full(), Pixels(za, az, elliptic(za, az)))
    assert fit.max_residual < 1e-9
    off_za, off_az = scattered(500)
    assert np.abs(fit.basis.synthesize(fit.coeffs, off_za, off_az) - elliptic(off_za, off_az)).max() < 1e-8


def test_samples_below_the_horizon_and_nan_are_left_out():
    za, az = np.meshgrid(np.linspace(0, np.pi, 61), np.arange(36) * np.pi / 18, indexing="ij")
    values = np.cos(za)
    values[za > 2] = np.nan
    values[10, 3] = np.nan
    pixels = Pixels.above_horizon(za.ravel(), az.ravel(), values.ravel())
    assert len(pixels.za) == 31 * 36 - 1
    fit = fit_basis(FourierBessel.full(8, 2), pixels)
    assert np.isfinite(fit.coeffs).all()
    assert fit.n_pixels == 31 * 36 - 1


@pytest.mark.parametrize("form", ["real", "complex"])
def test_largest_modes_are_kept_in_pairs_and_sorted(form):
    beam = CoefficientBeam(FourierBessel.full(6, 4), random_beam(FourierBessel.full(6, 4)), BeamInfo("b", 1e8, "ee"))
    everything = fit_beam(beam, FourierBessel.selection(None, form, k_max=6, m_max=4))
    amplitudes = everything.basis.amplitudes(everything.coeffs)
    assert everything.basis.n_modes == 54
    for n_modes in (1, 2, 7, 20, 54):
        kept = fit_beam(beam, FourierBessel.selection(n_modes, form, k_max=6, m_max=4)).basis
        chosen = [everything.basis.modes.index(mode) for mode in kept.modes]
        assert len(kept.modes) == n_modes
        assert (np.diff(amplitudes[chosen]) <= 1e-15).all()
        assert {(k, -m) for k, m in kept.modes} == set(kept.modes)
        # At most one pair, which had no room, is larger than what was kept.
        dropped = np.delete(amplitudes, chosen)
        assert np.sum(dropped > amplitudes[chosen].min()) <= 2


def test_modes_of_a_complex_beam_are_kept_one_by_one():
    basis = FourierBessel.full(3, 2, form="complex")
    coeffs = np.arange(1, 16) + 0.5j
    kept = basis.largest(abs(coeffs), 4)
    assert kept.modes == [basis.modes[n] for n in (14, 13, 12, 11)]


def test_kept_modes_are_fitted_again():
    beam = analytic_beam("gaussian", 150e6, diameter=4.0)
    spec = FourierBessel.selection(10, "real", k_max=20, m_max=0)
    fit = fit_beam(beam, spec)
    again = fit_basis(fit.basis, beam_pixels(beam))
    np.testing.assert_array_equal(fit.coeffs, again.coeffs)
    full = fit_beam(beam, FourierBessel.selection(None, "real", k_max=20, m_max=0))
    truncated = full.coeffs[:10]
    za, az = degree_grid()
    design = fit.basis.evaluate(za, az).T
    assert fit.rms_residual < np.sqrt(np.mean((design @ truncated - beam(za, az)) ** 2))


def test_zernike_polynomials_are_fitted_as_they_are():
    basis = Zernike(10)
    truth = generator(1, "zernike").standard_normal(basis.n_modes)
    fit = fit_beam(CoefficientBeam(basis, truth, BeamInfo("z", 1e8, "ee")), basis)
    assert fit.basis is basis
    np.testing.assert_allclose(fit.coeffs, truth, atol=1e-9)


def test_functions_between_horizon_and_edge_are_cut_not_invented():
    beam = analytic_beam("gaussian", 150e6, diameter=4.0)
    fit = fit_basis(FourierBessel.full(80, 0, edge=np.deg2rad(130)), beam_pixels(beam))
    assert fit.n_cut > 5
    assert np.abs(fit.coeffs).max() < 2 * np.sqrt(360)
    assert fit.max_residual < 1e-6


def test_complex_beam_needs_complex_coefficients():
    za, az = degree_grid()
    with pytest.raises(InputError, match="complex"):
        fit_basis(FourierBessel.full(3, 1, form="real"), Pixels(za, az, np.exp(1j * az)))


def test_more_modes_than_samples_are_refused():
    za, az = scattered(20)
    with pytest.raises(InputError, match=r"27 functions.*20 samples"):
        fit_basis(FourierBessel.full(3, 4), Pixels(za, az, np.ones(20)))
