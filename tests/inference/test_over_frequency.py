"""Covariances over channels, and the modes that they are made of."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal.windows import dpss

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.inference.over_frequency import KERNELS, legendre, modes_of, within_delay

EVEN: FloatArray = np.linspace(120e6, 132e6, 25)
UNEVEN: FloatArray = np.array([120.0, 120.5, 121.0, 124.0, 126.5, 130.0, 131.0, 138.0]) * 1e6


@pytest.mark.parametrize("freqs", [EVEN, UNEVEN])
@pytest.mark.parametrize("kernel", KERNELS)
def test_modes_make_the_covariance(kernel: str, freqs: FloatArray) -> None:
    covariance = KERNELS[kernel](freqs, 5e6)
    modes = modes_of(covariance)
    np.testing.assert_allclose(modes @ modes.T, covariance, atol=1e-13)
    own = modes.T @ modes
    np.testing.assert_allclose(own, np.diag(np.diag(own)), atol=1e-12)
    np.testing.assert_allclose(np.diag(covariance), 1.0, rtol=1e-15)


def test_kernels_fall_off_as_they_are_defined() -> None:
    freqs, length = np.array([0.0, 3.0]), 2.0
    x = 1.5
    falls = {
        "squared-exponential": np.exp(-0.5 * x**2),
        "matern-3/2": (1 + np.sqrt(3) * x) * np.exp(-np.sqrt(3) * x),
        "matern-5/2": (1 + np.sqrt(5) * x + 5 / 3 * x**2) * np.exp(-np.sqrt(5) * x),
    }
    assert {name: kernel(freqs, length)[0, 1] for name, kernel in KERNELS.items()} == pytest.approx(falls, rel=1e-14)


def test_a_smooth_kernel_has_few_modes_and_a_short_one_is_the_identity() -> None:
    assert modes_of(KERNELS["squared-exponential"](EVEN, 20e6)).shape[1] < 12
    np.testing.assert_array_equal(np.abs(modes_of(KERNELS["squared-exponential"](EVEN, 1.0))).sum(axis=0), np.ones(25))


def test_polynomials_span_what_polynomials_do_over_any_channels() -> None:
    modes = legendre(UNEVEN, 4)
    x = (UNEVEN - UNEVEN.mean()) / 1e7
    fitted = modes @ np.linalg.lstsq(modes, x**3 - x, rcond=None)[0]
    np.testing.assert_allclose(fitted, x**3 - x, atol=1e-13)
    assert np.mean(np.sum(modes**2, axis=1)) == pytest.approx(1.0, rel=1e-14)
    np.testing.assert_allclose(legendre(UNEVEN[:1], 1), [[1.0]], rtol=1e-15)


def test_modes_within_a_delay_are_prolate_spheroidal_sequences() -> None:
    spacing, delay = float(EVEN[1] - EVEN[0]), 200e-9
    modes = modes_of(within_delay(EVEN, delay), n_modes=4)
    expected = dpss(len(EVEN), delay * spacing * len(EVEN), 4)
    overlap = np.abs(expected @ modes) / np.linalg.norm(modes, axis=0)
    np.testing.assert_allclose(np.diag(overlap), 1.0, rtol=1e-9)
