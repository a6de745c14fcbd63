"""A Gaussian posterior: its mean, its covariance by the factor of its precision, draws and predictions."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import eigh, solve_triangular
from scipy.linalg.lapack import dpotri, zpotri

from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.inference.matrices import complete_hermitian
from hydrabeam_mpi.random import complex_normal


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
    def spectrum(self) -> tuple[FloatArray, Array]:
        """Eigenvalues of the precision, ascending, (n,), and its eigenvectors, (n, n).

        In the covariance the best-determined ones are beside the largest as small as rounding errors.
        """
        precision = self.factor @ self.factor.conj().T
        # LAPACK's search for a few of many (evr) may fail.
        values, vectors = eigh(precision, driver="evd", overwrite_a=True, check_finite=False)
        return np.asarray(values), np.asarray(vectors)

    @property
    def std(self) -> FloatArray:
        """Standard deviation of each coefficient, sqrt(E|x - mean|^2), (n,)."""
        return np.sqrt(np.diag(self.covariance).real)

    def predictive_variance(self, rows: Array) -> FloatArray:
        """Return E|a(x - mean)|^2 for each row ``a`` of ``rows``, (Nrows, n): the diagonal of F P^-1 F^H."""
        half = solve_triangular(self.factor, rows.conj().T, lower=True, check_finite=False)
        return np.einsum("ij,ij->j", half, half.conj()).real

    def draw(self, rng: np.random.Generator) -> Array:
        """Draw coefficients, (n,).

        The Gaussian constrained realisation solves P x = h + Sigma^(-1/2) w0 + A^H N^(-1/2) w1; its two noise
        terms together have covariance P = L L^H, so they are drawn as one, L w, and x = mean + L^-H w.
        """
        n = len(self.mean)
        white = complex_normal(rng, (n,)) if self.is_complex else rng.standard_normal(n)
        return self.mean + solve_triangular(self.factor, white, lower=True, trans="C", check_finite=False)
