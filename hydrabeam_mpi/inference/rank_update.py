"""Cholesky factors of matrices that have got another product of two vectors, in n^2 operations instead of n^3.

With P = L L^H, a = L^-1 u and b = L^-1 v

    P + u v^H + v u^H = L (1 + a b^H + b a^H) L^H = L (1 + p e e^H - q f f^H) L^H

where p and -q are the two eigenvalues of a b^H + b a^H. So p L e e^H L^H is added and q L f f^H L^H is taken away, a
column of the factor after the other (Golub and Van Loan 2013, section 6.5.4). Rounding errors grow with what is taken
away, and no other two products take away less.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import LinAlgError, solve_triangular

from hydrabeam_mpi.compiled import Compiled
from hydrabeam_mpi.data.observation import Array

LEAST_LEFT = 1e-8
"""Of the matrix along any direction, that must stay: of less the digits that rounding leaves are too few."""


def with_product(factor: Array, u: Array, v: Array) -> Array:
    """Return the lower Cholesky factor of L L^H + u v^H + v u^H, (n, n).

    Parameters
    ----------
    factor : ndarray, (n, n)
        Lower L.
    u, v : ndarray, (n,)

    Raises
    ------
    LinAlgError
        If the sum is not positive, or so nearly not that rounding decides.
    """
    basis, corner = np.linalg.qr(solve_triangular(factor, np.column_stack([u, v]), lower=True, check_finite=False))
    product = np.outer(corner[:, 0], corner[:, 1].conj())
    values, vectors = np.linalg.eigh(product + product.conj().T)
    if not 1 + values[0] > LEAST_LEFT:
        raise LinAlgError("the sum is not positive")
    changes = factor @ (basis @ vectors * np.sqrt(np.abs(values)))
    updated = np.array(factor, order="F")
    for value, change in zip(values[::-1], changes.T[::-1], strict=True):
        _rotate(updated, np.ascontiguousarray(change, dtype=updated.dtype), float(np.sign(value)))
    return updated


def _rotate_in_python(factor: Array, x: Array, sign: float) -> None:
    """Replace lower L, (n, n) in Fortran order, by the factor of L L^H + ``sign`` x x^H; x, (n,), is used up."""
    for k in range(len(x)):
        diagonal = factor[k, k].real
        root = np.sqrt(diagonal**2 + sign * (x[k].real ** 2 + x[k].imag ** 2))
        cosine, sine = root / diagonal, x[k] / diagonal
        back = sign * np.conj(sine)
        factor[k, k] = root
        for i in range(k + 1, len(x)):
            factor[i, k] = (factor[i, k] + back * x[i]) / cosine
            x[i] = cosine * x[i] - sine * factor[i, k]


_rotate = Compiled(_rotate_in_python)
