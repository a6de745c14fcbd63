"""What a posterior says of its precision and its covariance, by the factor that it has."""

from __future__ import annotations

import numpy as np
import pytest

from hydrabeam_mpi.data.observation import Array
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.random import complex_normal, generator


def precision(n: int, is_complex: bool) -> Array:
    rng = generator(3, "precision")
    rows = complex_normal(rng, (2 * n, n)) if is_complex else rng.standard_normal((2 * n, n))
    return rows.conj().T @ rows


@pytest.mark.parametrize("is_complex", [False, True])
@pytest.mark.parametrize("n", [1, 2, 40, 300])
@pytest.mark.parametrize("order", ["C", "F"])
def test_precision_and_covariance(n: int, is_complex: bool, order: str):
    """Of more rows than LAPACK works on at once, too."""
    stated = precision(n, is_complex)
    factor = np.array(np.linalg.cholesky(stated), order=order)
    posterior = Posterior(np.zeros(n, dtype=stated.dtype), factor)
    np.testing.assert_allclose(posterior.precision, stated, atol=1e-12 * np.abs(stated).max())
    np.testing.assert_allclose(posterior.covariance @ stated, np.eye(n), atol=1e-10)
    np.testing.assert_array_equal(factor, np.linalg.cholesky(stated))


@pytest.mark.parametrize("is_complex", [False, True])
def test_its_largest_eigenvalues(is_complex: bool):
    stated = precision(100, is_complex)
    posterior = Posterior(np.zeros(100), np.linalg.cholesky(stated))
    values, vectors = posterior.largest(3)
    np.testing.assert_allclose(values, np.linalg.eigvalsh(stated)[:-4:-1])
    np.testing.assert_allclose(stated @ vectors, vectors * values, atol=1e-6 * values[0])
    assert posterior.condition_number == pytest.approx(np.linalg.cond(stated))
