"""Fourier-Bessel modes against their definition and their orthonormality."""

import numpy as np
import pytest
from scipy.special import j0, jn_zeros, jnp_zeros, jv, roots_legendre

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.model.bases.bessel import BesselRows, chebyshev
from hydrabeam_mpi.model.bases.disc import EDGE
from hydrabeam_mpi.model.bases.fourier_bessel import FourierBessel, radial_zeros
from hydrabeam_mpi.random import generator

ALPHA = np.sqrt(1 - np.cos(23 * np.pi / 45))


def by_definition(k, m, za, az):
    """The paper's f_n, with its alpha and q_k."""
    u = jn_zeros(0, 80)[k - 1]
    rho = np.sqrt(2) * np.sin(za / 2) / ALPHA
    return jv(0, u * rho) / (jv(1, u) / np.sqrt(2)) * np.exp(1j * m * az) / np.sqrt(360)


def directions(n=3000):
    rng = generator(1, "directions")
    za = np.arccos(rng.uniform(0, 1, n))
    # Where accuracy is hardest to keep: close to the zenith, and at the horizon.
    za[:60] = np.logspace(-8, -1, 60)
    za[60], za[61] = 0, np.pi / 2
    return za, rng.uniform(0, 2 * np.pi, n)


def test_all_7280_modes_are_those_of_the_paper():
    za, az = directions(400)
    basis = FourierBessel.full(form="complex")
    assert basis.n_modes == 7280
    functions = basis.evaluate(za, az)
    for n in range(0, 7280, 13):
        expected = by_definition(*basis.modes[n], za, az)
        np.testing.assert_allclose(functions[n], expected, rtol=0, atol=1e-13 * np.abs(functions[n]).max())


def test_radial_functions_are_accurate_to_1e_13_everywhere():
    za, az = directions()
    basis = FourierBessel([(k, 0) for k in range(1, 81)], form="complex")
    expected = np.array([by_definition(k, 0, za, az).real for k in range(1, 81)])
    assert np.abs(basis.columns(za, az) - expected).max() < 1e-13 * np.abs(expected).max()


def test_azimuthal_functions_are_accurate_to_1e_13_everywhere():
    az = np.concatenate([np.linspace(-10, 10, 2001), [0.0, np.pi, -np.pi, 1e-9]])
    za = np.full(len(az), 0.3)
    modes = [(1, m) for m in range(-45, 46)]
    expected = np.array([by_definition(k, m, za, az) for k, m in modes])
    functions = FourierBessel(modes, form="complex").evaluate(za, az)
    assert np.abs(functions - expected).max() < 1e-13 * np.abs(expected).max()


def test_real_form_is_sqrt2_cos_and_sqrt2_sin():
    za, az = directions(100)
    values = FourierBessel([(4, 0), (4, 3), (4, -3)], form="real").evaluate(za, az)
    exponential = by_definition(4, 3, za, az)
    np.testing.assert_allclose(values[0], by_definition(4, 0, za, az).real, atol=1e-13)
    np.testing.assert_allclose(values[1], np.sqrt(2) * exponential.real, atol=1e-13)
    np.testing.assert_allclose(values[2], np.sqrt(2) * exponential.imag, atol=1e-13)


@pytest.mark.parametrize("form", ["real", "complex"])
@pytest.mark.parametrize("boundary", ["dirichlet", "neumann"])
def test_modes_are_orthonormal(form, boundary):
    """Over the disc with weight rho, by Gauss-Legendre quadrature, and over n_az equally spaced azimuths."""
    basis = FourierBessel.full(6, 4, form=form, boundary=boundary, n_az=36)
    x, weight = roots_legendre(60)
    rho = (x + 1) / 2
    za = np.arccos(1 - (ALPHA * rho) ** 2)
    grid_za, grid_az = np.meshgrid(za, np.arange(36) * 2 * np.pi / 36, indexing="ij")
    functions = basis.evaluate(grid_za.ravel(), grid_az.ravel())
    measure = np.repeat(weight / 2 * rho, 36)
    np.testing.assert_allclose((functions * measure) @ functions.conj().T, np.eye(basis.n_modes), atol=1e-11)


def test_boundary_conditions_hold_at_the_edge():
    edge = np.deg2rad(97)
    za = np.array([edge - 1e-5, edge])
    value = FourierBessel.full(5, 0, edge=edge, boundary="dirichlet").evaluate(za, np.zeros(2))
    assert np.abs(value[:, 1]).max() < 1e-13
    flat = FourierBessel.full(5, 0, edge=edge, boundary="neumann").evaluate(za, np.zeros(2))
    assert np.abs(flat[:, 0] - flat[:, 1]).max() < 1e-8
    assert np.abs(flat[:, 1]).min() > 0.01
    np.testing.assert_allclose(flat[0], np.sqrt(2 / 360), rtol=1e-13)


def test_zeros_are_counted_from_one():
    u, _ = radial_zeros(4, "neumann")
    np.testing.assert_allclose(u, [0, *jnp_zeros(0, 3)])
    u, _ = radial_zeros(4, "dirichlet")
    np.testing.assert_allclose(u, jn_zeros(0, 4))


def test_disc_is_the_paper_s():
    assert pytest.approx(np.deg2rad(92)) == EDGE
    za = np.array([0.0, 1e-9, 0.7, np.pi / 2, EDGE])
    basis = FourierBessel([(1, 0)])
    np.testing.assert_allclose(basis.rho(za), np.sqrt(2) * np.sin(za / 2) / ALPHA, rtol=1e-15)
    assert basis.rho(np.array([EDGE]))[0] == pytest.approx(1)


def test_beyond_the_edge_functions_go_on():
    edge = np.deg2rad(70)
    basis = FourierBessel.full(20, 0, form="complex", edge=edge)
    za = np.deg2rad([10.0, 69.99, 70.01, 90])
    u = jn_zeros(0, 20)[:, None]
    expected = j0(u * np.sin(za / 2) / np.sin(edge / 2)) / (jv(1, u) / np.sqrt(2)) / np.sqrt(360)
    np.testing.assert_allclose(basis.evaluate(za, np.zeros(4)), expected, atol=1e-13)


@pytest.mark.parametrize("order", [41, 60, 61, 159])
def test_chebyshev_rows_are_cosines(order):
    angle = np.concatenate([[0, np.pi], np.logspace(-7, 0, 50), np.linspace(0, np.pi, 500)])
    rows = np.empty((order, len(angle)))
    chebyshev(np.sin(angle / 2) ** 2, rows)
    np.testing.assert_allclose(rows, np.cos(np.arange(order)[:, None] * angle), atol=3e-13)


def test_bessel_rows_have_no_slow_denormal_numbers():
    rows = BesselRows(jn_zeros(0, 80), np.ones(80))
    tiny = np.abs(rows._table[rows._table != 0]).min()
    assert tiny > 1e-30


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"modes": []}, "at least one mode"),
        ({"modes": [(0, 1)]}, "k >= 1"),
        ({"modes": [(1, 1), (1, 1)]}, "once"),
        ({"modes": [(1, 0)], "form": "quaternion"}, "quaternion"),
        ({"modes": [(1, 0)], "boundary": "robin"}, "dirichlet"),
        ({"modes": [(1, 0)], "edge": 0.0}, "edge"),
        ({"modes": [(1, 0)], "edge": 92.0}, "edge"),
    ],
)
def test_bad_settings_are_told(arguments, words):
    with pytest.raises(InputError, match=words):
        FourierBessel(**arguments)
