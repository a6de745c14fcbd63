"""A Gaussian posterior: its mean, its covariance by the factor of its precision, draws and predictions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dlauum, dpotri, zlauum, zpotri
from scipy.sparse.linalg import ArpackNoConvergence, eigsh

from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.eigen import eigen
from hydrabeam_mpi.inference.matrices import complete_hermitian
from hydrabeam_mpi.random import complex_normal

DENSE = 64
"""Matrices with fewer rows are decomposed as a whole, which takes no time."""


@dataclass(frozen=True)
class Posterior:
    """A Gaussian posterior in terms of its mean and the factor of its precision.

    Attributes
    ----------
    mean : ndarray, (n,)
        Also the maximum a posteriori.
    factor : ndarray, (n, n)
        Lower L with L L^H the posterior precision.
    log_evidence : float or None
        ln p(d), natural logarithm of a density in Jy^(-2 n_data) of the data as read, before any gains are divided
        out; None with a flat prior.
    """

    mean: Array
    factor: Array
    log_evidence: float | None = None

    @classmethod
    def of(cls, mean: Array, covariance: Array) -> Posterior:
        """Return the Gaussian of a mean, (n,), and a covariance, (n, n).

        Raises
        ------
        numpy.linalg.LinAlgError
            If it is no covariance.
        """
        variance = np.diag(covariance).real
        if not np.all(variance > 0):
            raise np.linalg.LinAlgError("a variance is not positive")
        # In units of the standard deviations, which may be of very different size.
        std = np.sqrt(variance)
        inverse = np.linalg.inv(covariance / std / std[:, np.newaxis])
        precision = 0.5 * (inverse + inverse.conj().T) / std / std[:, np.newaxis]
        return cls(mean, np.linalg.cholesky(precision))

    @property
    def is_complex(self) -> bool:
        """Whether the coefficients are complex."""
        return bool(np.iscomplexobj(self.factor))

    @cached_property
    def covariance(self) -> Array:
        """P^-1, (n, n)."""
        invert = zpotri if self.is_complex else dpotri
        lower, info = invert(self.factor, lower=1)
        if info:  # pragma: no cover - a Cholesky factor has no zero on its diagonal
            raise ArithmeticError(f"potri failed with info = {info}")
        # The transpose of the lower triangle is the upper triangle of the transpose, which is the conjugate.
        complete_hermitian(lower.T)
        return np.asarray(lower)

    @cached_property
    def precision(self) -> Array:
        """P, (n, n)."""
        # LAPACK multiplies an upper triangle by its adjoint, which with rows and columns turned round the lower one is.
        multiply = zlauum if self.is_complex else dlauum
        upper, _ = multiply(np.array(self.factor[::-1, ::-1], order="F"), lower=0, overwrite_c=1)
        complete_hermitian(upper)
        return np.ascontiguousarray(upper[::-1, ::-1])

    def largest(self, k: int) -> tuple[FloatArray, Array]:
        """Return the ``k`` largest eigenvalues of the precision, descending, (k,), and their eigenvectors, (n, k).

        In the covariance the best-determined ones are beside the largest as small as rounding errors.
        """
        values, vectors = _largest(self.precision, k)
        # Eigenvectors have any phase; here their largest component is positive.
        top = vectors[np.argmax(np.abs(vectors), axis=0), np.arange(k)]
        return values, vectors * (np.abs(top) / top)

    @cached_property
    def condition_number(self) -> float:
        """Of the precision; at most what rounding errors leave of it."""
        (best,), _ = self.largest(1)
        (worst,), _ = _largest(self.covariance, 1)
        return float(min(best * worst, 1 / np.finfo(float).eps))

    @property
    def std(self) -> FloatArray:
        """Standard deviation of each coefficient, sqrt(E|x - mean|^2), (n,)."""
        return np.sqrt(np.diag(self.covariance).real)

    def predictive_variance(self, rows: Array) -> FloatArray:
        """Return E|a(x - mean)|^2 for each row ``a`` of ``rows``, (Nrows, n): the diagonal of F P^-1 F^H."""
        half = solve_triangular(self.factor, rows.conj().T, lower=True, check_finite=False)
        return np.einsum("ij,ij->j", half, half.conj()).real

    def carried(self, x: Array, other: Posterior) -> Array:
        """Return what is as far from another's mean as ``x`` from this one's, (n,), in deviations L^H (x - mean)."""
        white = self.factor.conj().T @ (x - self.mean)
        moved = solve_triangular(other.factor, white, lower=True, trans="C", check_finite=False)
        return np.asarray(other.mean + moved)

    def draw(self, rng: np.random.Generator) -> Array:
        """Draw coefficients, (n,)."""
        return self.draws([rng])[0]

    def draws(self, rngs: Sequence[np.random.Generator]) -> Array:
        """Draw coefficients with each of the generators, (Ndraws, n).

        The Gaussian constrained realisation solves P x = h + Sigma^(-1/2) w0 + A^H N^(-1/2) w1; its two noise
        terms together have covariance P = L L^H, so they are drawn as one, L w, and x = mean + L^-H w.
        """
        n = len(self.mean)
        each = [complex_normal(rng, (n,)) if self.is_complex else rng.standard_normal(n) for rng in rngs]
        white = np.array(each).reshape(len(each), n)
        if not len(white):
            return white.astype(self.mean.dtype)
        moved = solve_triangular(self.factor, white.T, lower=True, trans="C", check_finite=False).T
        return np.asarray(self.mean + moved)


def _largest(matrix: Array, k: int) -> tuple[FloatArray, Array]:
    """Return the ``k`` largest eigenvalues of a Hermitian matrix, descending, and their eigenvectors, (n, k)."""
    n = len(matrix)
    if max(DENSE, 4 * k) < n:
        try:
            # Begun from the same vector, so that the same matrix gives the same.
            values, vectors = eigsh(matrix, k, which="LA", v0=np.ones(n, dtype=matrix.dtype))
        except ArpackNoConvergence:
            values, vectors = eigen(matrix)
    else:
        values, vectors = eigen(matrix)
    order = np.argsort(values)[: -k - 1 : -1]
    return np.asarray(values[order].real), np.asarray(vectors[:, order])
