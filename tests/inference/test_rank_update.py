"""Factors that are updated are those of the whole matrices."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import LinAlgError, cholesky

from hydrabeam_mpi.data.observation import Array
from hydrabeam_mpi.inference.rank_update import with_product
from hydrabeam_mpi.random import complex_normal, generator

N = 150


def positive(n: int, is_complex: bool, spread: float = 1.0) -> Array:
    """Return a matrix whose rows are of sizes over ``spread`` e-foldings."""
    rng = generator(1, "matrix")
    rows = complex_normal(rng, (2 * n, n)) if is_complex else rng.standard_normal((2 * n, n))
    rows = rows * np.exp(np.linspace(0, spread, n))
    return rows.conj().T @ rows


def vectors(n: int, is_complex: bool) -> tuple[Array, Array]:
    rng = generator(2, "vectors")
    both = complex_normal(rng, (2, n)) if is_complex else rng.standard_normal((2, n))
    return both[0], both[1]


@pytest.mark.parametrize("is_complex", [False, True])
@pytest.mark.parametrize("spread", [1.0, 15.0])
def test_the_factor_is_that_of_the_sum(is_complex: bool, spread: float):
    matrix = positive(N, is_complex, spread)
    u, v = (0.05 * np.sqrt(np.diag(matrix).real) * one for one in vectors(N, is_complex))
    product = np.outer(u, v.conj())
    direct = cholesky(matrix + product + product.conj().T, lower=True)
    before = cholesky(matrix, lower=True)
    kept = before.copy()
    found = with_product(before, u, v)
    np.testing.assert_array_equal(before, kept)
    size = np.sqrt(np.diag(matrix).real)[:, np.newaxis]
    np.testing.assert_allclose(found / size, direct / size, atol=1e-11)
    assert np.all(np.triu(found, 1) == 0)


def test_a_real_matrix_may_be_in_any_order():
    matrix = positive(N, False)
    u, v = (0.1 * one for one in vectors(N, False))
    lower = cholesky(matrix, lower=True)
    one, two = (with_product(np.array(lower, order=order), u, v) for order in ("C", "F"))
    np.testing.assert_allclose(one, two, atol=1e-13)


def test_nothing_added_changes_nothing():
    lower = cholesky(positive(N, True), lower=True)
    u, _ = vectors(N, True)
    np.testing.assert_allclose(with_product(lower, u, np.zeros(N, dtype=complex)), lower, rtol=1e-13)


@pytest.mark.parametrize("is_complex", [False, True])
def test_a_sum_that_is_not_positive_has_no_factor(is_complex: bool):
    matrix = positive(N, is_complex)
    u, _ = vectors(N, is_complex)
    with pytest.raises(LinAlgError):
        with_product(cholesky(matrix, lower=True), 100 * u, -100 * u)


def test_what_is_nearly_taken_away_keeps_its_digits():
    """All but a millionth of the matrix along u."""
    matrix = positive(N, True)
    u, _ = vectors(N, True)
    most = 1 / np.vdot(u, np.linalg.solve(matrix, u)).real
    goes = 0.5 * (1 - 1e-6) * most
    found = with_product(cholesky(matrix, lower=True), goes * u, -u)
    left = matrix - 2 * goes * np.outer(u, u.conj())
    np.testing.assert_allclose(found @ found.conj().T, left, atol=1e-10 * np.abs(matrix).max())
    along = np.linalg.solve(matrix, u)
    assert np.vdot(along, found @ (found.conj().T @ along)).real == pytest.approx(
        np.vdot(along, left @ along).real, rel=1e-6
    )
