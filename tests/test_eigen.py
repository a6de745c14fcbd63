import numpy as np
import pytest

from hydrabeam_mpi.eigen import eigen
from hydrabeam_mpi.random import complex_normal, generator


@pytest.mark.parametrize("is_complex", [False, True])
def test_eigenvectors_make_the_matrix(is_complex: bool) -> None:
    rng = generator(2, "eigen")
    root = complex_normal(rng, (40, 30)) if is_complex else rng.standard_normal((40, 30))
    matrix = root @ root.conj().T
    values, vectors = eigen(matrix)
    assert np.all(np.diff(values) >= 0)
    np.testing.assert_allclose((vectors * values) @ vectors.conj().T, matrix, rtol=0, atol=1e-12 * values[-1])
    np.testing.assert_allclose(vectors.conj().T @ vectors, np.eye(40), rtol=0, atol=1e-12)
