"""Visibility engines: from sources and beam columns to design rows. They are exchangeable (HDBI II, section 2.3).

Every engine computes, for one time, the real-column design

    F[f, u, c] = 1/2 sum_s I_s(f) g_c(s) exp(+2 pi i nu_f b_u.s / c_light)

with g_c the real columns of a beam basis. The factor 1/2 is stated here and nowhere else (HDBI II, eq. 2).
"""

from __future__ import annotations

from itertools import pairwise
from typing import Protocol

import finufft
import numpy as np
from scipy.linalg.blas import dgemm
from threadpoolctl import threadpool_info

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray
from hydrabeam_mpi.model.fringes import C_M_PER_S, Fringes
from hydrabeam_mpi.model.positions import enu


class Columns(Protocol):
    """What an engine needs of a beam basis: its real columns."""

    @property
    def n_columns(self) -> int:
        """Number of real columns."""

    def columns(self, za: FloatArray, az: FloatArray, out: FloatArray | None = None) -> FloatArray:
        """Evaluate all columns, (n_columns, Npoints)."""


class Engine(Protocol):
    """One way to compute design rows for a fixed set of baseline vectors."""

    @property
    def n_vectors(self) -> int:
        """Number of baseline vectors."""

    def design(self, basis: Columns, za: FloatArray, az: FloatArray, flux: FloatArray, freqs: FloatArray) -> FloatArray:
        """Compute the design of one time.

        Parameters
        ----------
        basis : Columns
            The beam basis.
        za, az : ndarray, (Nsrc,)
            Sources above the horizon, radians.
        flux : ndarray, (Nfreqs, Nsrc)
            Jy.
        freqs : ndarray, (Nfreqs,)
            Hz.

        Returns
        -------
        ndarray, (Nfreqs, 2, Nvectors, n_columns)
            Real parts, then imaginary parts.
        """


class GemmEngine:
    """Dense products, source chunk by source chunk; the arrays of a chunk stay in cache.

    Parameters
    ----------
    vectors : ndarray, (Nvectors, 3)
        Baseline vectors in metres ENU.
    tol : float
        Distance in metres within which vectors count as lying on a lattice.
    chunk : int
        Sources treated at once.
    """

    def __init__(self, vectors: FloatArray, tol: float = 1e-7, chunk: int = 1024) -> None:
        self.fringes = Fringes(vectors, tol)
        self.chunk = chunk

    @property
    def n_vectors(self) -> int:
        """Number of baseline vectors."""
        return len(self.fringes.vectors)

    def design(self, basis: Columns, za: FloatArray, az: FloatArray, flux: FloatArray, freqs: FloatArray) -> FloatArray:
        """Compute the design of one time; see `Engine.design`."""
        n_vectors = self.n_vectors
        out = np.zeros((len(freqs), 2 * n_vectors, basis.n_columns))
        directions = enu(za, az)
        # Chunks of equal size: a short last one would cost nearly as much as a full one.
        n_chunks = max(-(-len(za) // self.chunk), 1)
        edges = np.linspace(0, len(za), n_chunks + 1).astype(int)
        # One work space for all chunks: fresh pages cost as much as what is computed in them.
        n_rows = basis.n_columns + 2 * n_vectors
        space = np.empty(n_rows * self.chunk)
        for lo, hi in pairwise(edges.tolist()):
            rows = space[: n_rows * (hi - lo)].reshape(n_rows, hi - lo)
            columns = basis.columns(za[lo:hi], az[lo:hi], out=rows[: basis.n_columns])
            fringes = rows[basis.n_columns :]
            for f, freq in enumerate(freqs):
                parts = fringes.reshape(2, n_vectors, hi - lo)
                self.fringes.fill(parts, directions[:, lo:hi], 0.5 * flux[f, lo:hi], float(freq))
                _add_product(out[f], fringes, columns)
        return out.reshape(len(freqs), 2, n_vectors, basis.n_columns)


def _add_product(out: FloatArray, a: FloatArray, b: FloatArray) -> None:
    """Add ``a @ b.T`` to ``out`` in place; all three C-ordered, so that BLAS copies nothing."""
    if a.shape[1]:
        dgemm(1.0, b.T, a.T, beta=1.0, c=out.T, trans_a=1, overwrite_c=1)


class NufftEngine:
    """Type-3 non-uniform FFTs (finufft), for many sources: the cost does not grow as sources x baselines.

    Parameters
    ----------
    vectors : ndarray, (Nvectors, 3)
        Baseline vectors in metres ENU.
    eps : float
        Relative precision asked of the transform.
    batch : int
        Columns transformed at once.
    """

    def __init__(self, vectors: FloatArray, eps: float = 1e-12, batch: int = 64) -> None:
        self.vectors = np.ascontiguousarray(vectors, dtype=float)
        self.eps = eps
        self.batch = batch
        self.coplanar = bool(np.abs(self.vectors[:, 2]).max(initial=0.0) < 1e-9)
        # finufft would take all cores, whatever share of them OpenMP has been limited to; 0 leaves it to finufft.
        pools = threadpool_info()
        self.threads = max((pool["num_threads"] for pool in pools if pool["user_api"] == "openmp"), default=0)

    @property
    def n_vectors(self) -> int:
        """Number of baseline vectors."""
        return len(self.vectors)

    def design(self, basis: Columns, za: FloatArray, az: FloatArray, flux: FloatArray, freqs: FloatArray) -> FloatArray:
        """Compute the design of one time; see `Engine.design`."""
        n_vectors, n_columns = len(self.vectors), basis.n_columns
        out = np.zeros((len(freqs), 2, n_vectors, n_columns))
        if not len(za):
            return out
        columns = basis.columns(za, az)
        dims = 2 if self.coplanar else 3
        points = [np.ascontiguousarray(axis) for axis in enu(za, az)[:dims]]
        for f, freq in enumerate(freqs):
            targets = [np.ascontiguousarray(axis) for axis in (2 * np.pi * freq / C_M_PER_S * self.vectors.T)[:dims]]
            for lo in range(0, n_columns, self.batch):
                strengths = (0.5 * flux[f]) * columns[lo : lo + self.batch]
                values = self._transform(points, strengths.astype(complex), targets)
                out[f, 0, :, lo : lo + self.batch] = values.real.T
                out[f, 1, :, lo : lo + self.batch] = values.imag.T
        return out

    def _transform(self, points: list[FloatArray], strengths: ComplexArray, targets: list[FloatArray]) -> ComplexArray:
        transform = finufft.nufft2d3 if self.coplanar else finufft.nufft3d3
        values = transform(*points, strengths, *targets, isign=1, eps=self.eps, nthreads=self.threads)
        return np.atleast_2d(values)


def make_engine(kind: str, vectors: FloatArray) -> GemmEngine | NufftEngine:
    """Build the engine that the job names, "gemm" or "nufft"."""
    return NufftEngine(vectors) if kind == "nufft" else GemmEngine(vectors)
