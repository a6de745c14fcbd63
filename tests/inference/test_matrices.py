"""Inverses of Hermitian matrices, by a Cholesky factor where there is one."""

from __future__ import annotations

import numpy as np
import pytest

from hydrabeam_mpi.inference.matrices import inverse_hermitian, inverse_where_it_varies
from hydrabeam_mpi.random import complex_normal, generator


@pytest.mark.parametrize("n", [0, 1, 7, 200])
@pytest.mark.parametrize("is_complex", [False, True], ids=["real", "complex"])
@pytest.mark.parametrize("least", [1.0, -1.0], ids=["positive", "not positive"])
def test_times_the_matrix_is_one(n: int, is_complex: bool, least: float) -> None:
    rng = generator(1, "inverse", n)
    vectors = complex_normal(rng, (n, n)) if is_complex else rng.standard_normal((n, n))
    vectors, _ = np.linalg.qr(vectors)
    values = np.linspace(1.0, 5.0, n)
    values[:1] = least
    matrix = (vectors * values) @ vectors.conj().T
    before = matrix.copy()
    found = inverse_hermitian(matrix)
    np.testing.assert_allclose(found @ matrix, np.eye(n), atol=1e-11)
    np.testing.assert_array_equal(matrix, before)
    assert np.iscomplexobj(found) == is_complex


def test_a_covariance_is_inverted_where_it_varies() -> None:
    """Standard deviations from 1e-9 to 1e6; one number is held, and two are the same."""
    rng = generator(2, "inverse")
    root = rng.standard_normal((6, 8)) * np.logspace(-9, 6, 6)[:, np.newaxis]
    root[2] = 0.0
    root[5] = root[4]
    covariance = root @ root.T
    inverse = inverse_where_it_varies(covariance)
    np.testing.assert_allclose(covariance @ inverse @ covariance, covariance, rtol=1e-9)


@pytest.mark.parametrize("dtype", [float, complex])
def test_a_singular_matrix_is_inverted_where_it_is_not_zero(dtype: type) -> None:
    matrix = np.zeros((3, 3), dtype=dtype)
    matrix[:2, :2] = [[2.0, 0.5], [0.5, 1.0]]
    found = inverse_hermitian(matrix)
    np.testing.assert_allclose(found[:2, :2], np.linalg.inv(matrix[:2, :2]), atol=1e-14)
    assert not found[2].any()
