"""Zernike polynomials against their definition by factorials and their orthonormality."""

from math import factorial

import numpy as np
import pytest
from scipy.special import roots_legendre

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.model.bases.zernike import Zernike

EDGE = np.deg2rad(92)


def radial(n, m, rho):
    terms = [
        (-1) ** s
        * factorial(n - s)
        / (factorial(s) * factorial((n + m) // 2 - s) * factorial((n - m) // 2 - s))
        * rho ** (n - 2 * s)
        for s in range((n - m) // 2 + 1)
    ]
    return np.sum(terms, axis=0)


def test_polynomials_are_in_osa_order():
    za = np.deg2rad(np.linspace(0, 92, 40))
    az = np.linspace(0, 6, 40)
    rho = np.sin(za / 2) / np.sin(EDGE / 2)
    values = Zernike(8).columns(za, az)
    assert len(values) == 45
    for n in range(9):
        for m in range(-n, n + 1, 2):
            norm = np.sqrt(n + 1) if m == 0 else np.sqrt(2 * n + 2)
            angular = np.cos(m * az) if m >= 0 else np.sin(-m * az)
            expected = norm * radial(n, abs(m), rho) * angular
            np.testing.assert_allclose(values[(n * (n + 2) + m) // 2], expected, atol=1e-11)


def test_high_degrees_are_orthonormal_on_the_disc():
    degree = 40
    x, weight = roots_legendre(60)
    rho = (x + 1) / 2
    za = 2 * np.arcsin(rho * np.sin(EDGE / 2))
    n_az = 2 * degree + 1
    grid_za, grid_az = np.meshgrid(za, np.arange(n_az) * 2 * np.pi / n_az, indexing="ij")
    values = Zernike(degree).columns(grid_za.ravel(), grid_az.ravel())
    # The mean over the disc: 2 rho d rho times the mean over azimuth.
    measure = np.repeat(weight * rho, n_az) / n_az
    np.testing.assert_allclose((values * measure) @ values.T, np.eye(len(values)), atol=1e-11)


@pytest.mark.parametrize(("arguments", "words"), [((-1,), "degree"), ((3, 0.0), "edge")])
def test_bad_settings_are_told(arguments, words):
    with pytest.raises(InputError, match=words):
        Zernike(*arguments)
