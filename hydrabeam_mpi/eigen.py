"""Eigenvalues and eigenvectors, also where LAPACK's fast routine does not find them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

IN_A_SECOND = 1000
"""Rows of a matrix that is decomposed in about a second."""


def eigen(matrix: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[Any]]:
    """Return the eigenvalues, rising, and the eigenvectors of Hermitian matrices, (..., n) and (..., n, n).

    By the fast driver of LAPACK, and where that fails by the one that goes step by step: some builds of OpenBLAS do not
    come to an end for some well-conditioned matrices of a few hundred rows.
    """
    try:
        values, vectors = np.linalg.eigh(matrix)
    except np.linalg.LinAlgError:
        shape = np.shape(matrix)
        each = [eigh(one, driver="ev") for one in np.reshape(matrix, (-1, *shape[-2:]))]
        values = np.reshape([one[0] for one in each], shape[:-1])
        vectors = np.reshape([one[1] for one in each], shape)
    return values, vectors
