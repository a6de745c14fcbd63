"""Eigenvalues and eigenvectors, also where LAPACK's fast routine does not find them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh


def eigen(matrix: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[Any]]:
    """Return the eigenvalues, rising, and the eigenvectors of a Hermitian matrix, (n,) and (n, n).

    By the fast driver of LAPACK, and where that fails by the one that goes step by step: some builds of OpenBLAS do not
    come to an end for some well-conditioned matrices of a few hundred rows.
    """
    try:
        values, vectors = np.linalg.eigh(matrix)
    except np.linalg.LinAlgError:
        values, vectors = eigh(matrix, driver="ev")
    return values, vectors
