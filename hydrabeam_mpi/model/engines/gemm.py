"""Design rows by matrix products."""

from __future__ import annotations

import numpy as np
from scipy.linalg.blas import dgemm

from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.model.engines.base import Columns, Engine, Precision, amplitude, chunks
from hydrabeam_mpi.model.engines.fringes import enu

SUMMED_IN_SINGLE = 512
"""Sources over which is summed in single precision: each term loses digits to the sum so far, so that half as many lose
less by a factor of 1.4, and with fewer the sums in double precision take as long as the products."""


class GemmEngine(Engine):
    """Dense products, source chunk by source chunk; the arrays of a chunk stay in cache.

    Parameters
    ----------
    vectors : ndarray, (Nvectors, 3)
        Baseline vectors in metres ENU.
    tol : float
        Distance in metres within which vectors count as lying on a lattice.
    chunk : int
        Sources treated at once, twice as many in single precision.
    """

    def __init__(self, vectors: FloatArray, tol: float = 1e-7, chunk: int = 1024) -> None:
        super().__init__(vectors, tol)
        self.chunk = chunk

    def design(
        self,
        basis: Columns,
        za: FloatArray,
        az: FloatArray,
        flux: FloatArray,
        freqs: FloatArray,
        precision: Precision = np.float64,
    ) -> FloatArray:
        """Compute the design of one time, (Nfreqs, 2, Nvectors, n_columns); see `Engine.design`."""
        n_vectors, n_columns = self.n_vectors, basis.n_columns
        n_rows = n_columns + 2 * n_vectors
        out = np.zeros((len(freqs), 2 * n_vectors, n_columns))
        if not n_vectors:
            return out.reshape(len(freqs), 2, 0, n_columns)
        directions = enu(za, az)
        space: Array = self._work_space(n_rows * self.chunk).view(precision)
        for lo, hi in chunks(len(za), self.chunk * 8 // space.itemsize):
            rows = space[: n_rows * (hi - lo)].reshape(n_rows, hi - lo)
            columns = basis.columns(za[lo:hi], az[lo:hi], out=rows[:n_columns])
            fringes = rows[n_columns:]
            parts = fringes.reshape(2, n_vectors, hi - lo)
            for f, freq in enumerate(freqs):
                self.fringes.fill(parts, directions[:, lo:hi], amplitude(flux[f, lo:hi]), float(freq))
                _add_product(out[f], fringes, columns)
        return out.reshape(len(freqs), 2, n_vectors, n_columns)


def _add_product(out: FloatArray, a: FloatArray, b: FloatArray) -> None:
    """Add ``a @ b.T`` to ``out``, in double precision, in place; all C-ordered, so that BLAS copies nothing."""
    if a.dtype != out.dtype:
        for lo in range(0, a.shape[1], SUMMED_IN_SINGLE):
            part = slice(lo, lo + SUMMED_IN_SINGLE)
            out += a[:, part] @ b[:, part].T
    elif a.shape[1]:
        dgemm(1.0, b.T, a.T, beta=1.0, c=out.T, trans_a=1, overwrite_c=1)
