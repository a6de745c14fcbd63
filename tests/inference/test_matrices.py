"""Inverses of Hermitian matrices, by a Cholesky factor where there is one."""

from __future__ import annotations

import numpy as np
import pytest

from hydrabeam_mpi.inference.matrices import inverse_hermitian
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
