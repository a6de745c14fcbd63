"""Hermitian matrices of which one triangle has been worked out, and their factors."""

from __future__ import annotations

import numpy as np
from scipy.linalg import LinAlgError, cholesky
from scipy.linalg.lapack import dpotrf, dpotri, zpotrf, zpotri

from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.eigen import eigen
from hydrabeam_mpi.errors import InputError

AT_ONCE = 128
"""Rows and columns of a block that stays in cache while it is transposed."""


def complete_hermitian(matrix: Array) -> None:
    """Fill the lower triangle of a Hermitian matrix from its upper one, in place and block by block; (n, n)."""
    for lo in range(0, len(matrix), AT_ONCE):
        hi = lo + AT_ONCE
        corner = np.triu(matrix[lo:hi, lo:hi])
        matrix[lo:hi, lo:hi] = corner + np.triu(corner, 1).conj().T
        matrix[hi:, lo:hi] = matrix[lo:hi, hi:].conj().T


def inverse_of_covariance(covariance: FloatArray) -> FloatArray:
    """Invert a covariance, (n, n), whose standard deviations may be of very different size."""
    std = np.sqrt(np.diag(covariance))
    inverse: FloatArray = np.linalg.inv(covariance / std / std[:, np.newaxis]) / std / std[:, np.newaxis]
    return 0.5 * (inverse + inverse.T)


def inverse_where_it_varies(covariance: FloatArray) -> FloatArray:
    """Invert a covariance, (n, n), as above, some combinations of which may not vary at all: there it is zero.

    By eigenvalues of its correlations: the singular values of a thousand numbers are not always found.
    """
    variances = np.diag(covariance)
    std = np.where(variances > 0, np.sqrt(np.maximum(variances, 0.0)), 1.0)
    inverse: FloatArray = np.linalg.pinv(covariance / std / std[:, np.newaxis], hermitian=True)
    return inverse / std / std[:, np.newaxis]


def inverse_hermitian(matrix: Array) -> Array:
    """Invert a Hermitian matrix, (n, n), also where rounding has left it not quite positive.

    Where it is positive its Cholesky factor tells the inverse, in a third of the time that one of any sort takes. Where
    it is singular, directions in which it is zero are left out.
    """
    factorise, invert = (zpotrf, zpotri) if np.iscomplexobj(matrix) else (dpotrf, dpotri)
    factor, failed = factorise(matrix, lower=1) if len(matrix) else (matrix, 1)
    if failed:
        try:
            return np.asarray(np.linalg.inv(matrix))
        except LinAlgError:
            values, vectors = eigen(matrix)
            told = np.abs(values) > len(values) * np.finfo(float).eps * np.abs(values).max()
            return np.asarray((vectors[:, told] / values[told]) @ vectors[:, told].conj().T)
    lower, _ = invert(factor, lower=1, overwrite_c=1)
    complete_hermitian(lower.T)
    return np.asarray(lower)


def cholesky_lower(matrix: Array) -> Array:
    """Return L with L L^H = ``matrix``, whose memory may be used for it; both are (n, n).

    Raises
    ------
    InputError
        If the matrix is not positive definite: the data and the prior leave some combination of coefficients
        free.
    """
    try:
        return cholesky(matrix, lower=True, check_finite=False, overwrite_a=True)
    except LinAlgError as error:
        raise InputError(
            "the posterior precision is not positive definite: data and prior leave some beam modes free",
            field="[prior]",
            remedy="use fewer modes, more data, or a prior that is not flat",
        ) from error
