"""A prior of independent coefficients, some of which go together, against dense Gaussians."""

from __future__ import annotations

import numpy as np
import pytest

from hydrabeam_mpi.data.observation import Array
from hydrabeam_mpi.inference.mode_widths import ModeSizes, PriorWidths
from hydrabeam_mpi.inference.prior import DiagonalPrior
from hydrabeam_mpi.random import complex_normal, generator

SIGMA = np.array([1e-3, 1.0, 30.0, 0.2, 5.0])


def shape_of(is_complex: bool, k: int = 2) -> Array:
    rng = generator(1, "shape")
    return complex_normal(rng, (5, k)) if is_complex else rng.standard_normal((5, k))


@pytest.mark.parametrize("is_complex", [False, True])
@pytest.mark.parametrize("k", [None, 0, 2, 7])
def test_it_is_the_gaussian_of_this_covariance(is_complex: bool, k: int | None) -> None:
    shape = None if k is None else shape_of(is_complex, k)
    prior = DiagonalPrior(np.arange(5.0), SIGMA, shape=shape)
    covariance = np.diag(SIGMA**2) + (0 if shape is None else shape @ shape.conj().T)
    precision = np.linalg.inv(covariance)
    found = np.ones((5, 5), dtype=covariance.dtype)
    prior.add_precision(found)
    np.testing.assert_allclose(found - 1, precision, rtol=0, atol=1e-8 * np.abs(precision).max())
    vector = complex_normal(generator(2, "vector"), (5,))
    np.testing.assert_allclose(prior.precision_times(vector), precision @ vector, rtol=1e-8)
    assert prior.log_det_precision == pytest.approx(float(np.linalg.slogdet(precision)[1]), rel=1e-9)
    np.testing.assert_allclose(prior.std(), np.sqrt(np.diag(covariance).real), rtol=1e-12)


def test_what_goes_together_stays_when_widths_are_adapted() -> None:
    sizes = ModeSizes(np.ones(5), np.zeros((5, 2), dtype=int), 1.0)
    prior = DiagonalPrior.of(np.zeros(5), sizes, PriorWidths(0.1), shape_of(False)).adapted(PriorWidths(0.2))
    np.testing.assert_array_equal(prior.sigma, 0.2)
    np.testing.assert_array_equal(prior.shape, shape_of(False))
