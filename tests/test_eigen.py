import numpy as np
import pytest

from hydrabeam_mpi.eigen import eigen
from hydrabeam_mpi.random import complex_normal, generator


@pytest.mark.parametrize("is_complex", [False, True])
@pytest.mark.parametrize("which", [(), (3,), (2, 3)])
@pytest.mark.parametrize("fast", [True, False])
def test_eigenvectors_make_the_matrix(
    is_complex: bool, which: tuple[int, ...], fast: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One and several, also where the fast driver does not find them."""
    rng, shape = generator(2, "eigen"), (*which, 40, 30)
    root = complex_normal(rng, shape) if is_complex else rng.standard_normal(shape)
    matrix = root @ root.conj().swapaxes(-1, -2)
    if not fast:
        monkeypatch.setattr(np.linalg, "eigh", _without_an_end)
    values, vectors = eigen(matrix)
    assert np.all(np.diff(values) >= 0)
    made = (vectors * values[..., np.newaxis, :]) @ vectors.conj().swapaxes(-1, -2)
    np.testing.assert_allclose(made, matrix, rtol=0, atol=1e-12 * values.max())
    product = vectors.conj().swapaxes(-1, -2) @ vectors
    np.testing.assert_allclose(product, np.broadcast_to(np.eye(40), product.shape), rtol=0, atol=1e-12)


def _without_an_end(matrix: np.ndarray) -> None:
    raise np.linalg.LinAlgError("Eigenvalues did not converge")
