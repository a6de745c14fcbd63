"""The additive sufficient statistics of a linear model with Gaussian noise.

From every row d = A x + n with E|n|^2 = 1/w the normal equations need only

    A^H N^-1 A,   A^H N^-1 d,   d^H N^-1 d,   ln|N|   and the number of data,

which add up over rows, hence over ranks (HDBI II, eqs 12 and 13).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import dsyrk, zherk

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray

Array = NDArray[Any]


@dataclass
class NormalEquations:
    """Sums over rows.

    Attributes
    ----------
    gram : ndarray, (n, n)
        A^H N^-1 A; for real coefficients its real part. Only one triangle is filled until `symmetrise`.
    projection : ndarray, (n,)
        A^H N^-1 d; for real coefficients its real part.
    scalars : ndarray, (3,)
        d^H N^-1 d, ln|N^-1| and the number of (complex) data.
    """

    gram: Array
    projection: Array
    scalars: FloatArray = field(default_factory=lambda: np.zeros(3))

    @classmethod
    def zeros(cls, n: int, is_complex: bool) -> NormalEquations:
        """Return empty sums for ``n`` real or complex coefficients."""
        dtype = np.complex128 if is_complex else np.float64
        return cls(np.zeros((n, n), dtype=dtype, order="F"), np.zeros(n, dtype=dtype))

    @property
    def n(self) -> int:
        """Number of coefficients."""
        return len(self.projection)

    @property
    def is_complex(self) -> bool:
        """Whether the coefficients are complex."""
        return bool(np.iscomplexobj(self.projection))

    @property
    def data_norm(self) -> float:
        """d^H N^-1 d."""
        return float(self.scalars[0])

    @property
    def log_det_inv_noise(self) -> float:
        """ln|N^-1| over the data with non-zero weight."""
        return float(self.scalars[1])

    @property
    def n_data(self) -> int:
        """Number of complex data with non-zero weight."""
        return round(float(self.scalars[2]))

    def add_data(self, data: ComplexArray, inv_noise_var: FloatArray) -> None:
        """Account for data in the scalar sums; the rows follow by `add_rows`, compressed or not."""
        used = inv_noise_var > 0
        weights = inv_noise_var[used]
        self.scalars += (np.sum(weights * np.abs(data[used]) ** 2), np.sum(np.log(weights)), weights.size)

    def add_rows(self, rows: Array, weighted_data: ComplexArray, weights: FloatArray) -> None:
        """Add rows of the design matrix.

        Parameters
        ----------
        rows : ndarray of complex, (Nrows, n); or of real, (2, Nrows, n)
            For real coefficients the real and the imaginary parts of the rows, one after the other.
        weighted_data : ndarray of complex, (Nrows,)
            Sum of w d over the data that share the row.
        weights : ndarray, (Nrows,)
            Sum of w over them.
        """
        root = np.sqrt(weights)[:, np.newaxis]
        if self.is_complex:
            conjugate = rows.conj()
            self.projection += conjugate.T @ weighted_data
            conjugate *= root
            self.gram = zherk(1.0, conjugate.T, beta=1.0, c=self.gram, overwrite_c=1)
        else:
            self.projection += rows[0].T @ weighted_data.real + rows[1].T @ weighted_data.imag
            scaled = (rows * root).reshape(-1, self.n)
            self.gram = dsyrk(1.0, scaled.T, beta=1.0, c=self.gram, overwrite_c=1)

    def symmetrise(self) -> None:
        """Fill the other triangle of the Gram matrix; once, after the last rows and the sum over ranks."""
        complete_hermitian(self.gram)


def complete_hermitian(matrix: Array, block: int = 128) -> None:
    """Fill the lower triangle of a Hermitian matrix from its upper one, in place and block by block."""
    for lo in range(0, len(matrix), block):
        hi = lo + block
        corner = np.triu(matrix[lo:hi, lo:hi])
        matrix[lo:hi, lo:hi] = corner + np.triu(corner, 1).conj().T
        matrix[hi:, lo:hi] = matrix[lo:hi, hi:].conj().T


class RowBuffer:
    """Collects rows of several times, so that the rank-k updates of the Gram matrix are large ones.

    Parameters
    ----------
    normal : NormalEquations
        Where full buffers are added.
    capacity : int
        Rows held before they are added.
    """

    def __init__(self, normal: NormalEquations, capacity: int = 512) -> None:
        self.normal = normal
        self.capacity = capacity
        self._held: list[tuple[Array, ComplexArray, FloatArray]] = []

    def add(self, rows: Array, weighted_data: ComplexArray, weights: FloatArray) -> None:
        """Take rows as `NormalEquations.add_rows` does; rows without weight are left out."""
        used = weights > 0
        if not used.all():
            rows, weighted_data, weights = rows[..., used, :], weighted_data[used], weights[used]
        self._held.append((rows, weighted_data, weights))
        if sum(len(held[2]) for held in self._held) >= self.capacity:
            self.flush()

    def flush(self) -> None:
        """Add what is held."""
        if self._held:
            rows, weighted_data, weights = zip(*self._held, strict=True)
            self._held = []
            self.normal.add_rows(np.concatenate(rows, axis=-2), np.concatenate(weighted_data), np.concatenate(weights))
