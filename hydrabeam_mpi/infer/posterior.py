"""The analytic posterior of a linear Gaussian model (HDBI II, eqs 12-15).

With P = Sigma^-1 + kappa A^H N^-1 A and h = Sigma^-1 mu + kappa A^H N^-1 d the posterior is N(P^-1 h, P^-1), where
kappa = 1 for complex coefficients, whose density is exp(-x^H P x), and kappa = 2 for real ones, whose density is
exp(-x^T P x / 2) and which take the real part of the products.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dpotri, zpotri

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.infer.normal import NormalEquations, complete_hermitian
from hydrabeam_mpi.infer.prior import Prior, cholesky_lower
from hydrabeam_mpi.random import complex_normal

Array = NDArray[Any]


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
        ln p(d), natural logarithm of a density in Jy^(-2 n_data); None with a flat prior.
    """

    mean: Array
    factor: Array
    log_evidence: float | None = None

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

    @property
    def std(self) -> FloatArray:
        """Standard deviation of each coefficient, sqrt(E|x - mean|^2)."""
        return np.sqrt(np.diag(self.covariance).real)

    def predictive_variance(self, rows: Array) -> FloatArray:
        """Return E|a(x - mean)|^2 for each row ``a`` of ``rows``, (Nrows, n): the diagonal of F P^-1 F^H."""
        half = solve_triangular(self.factor, rows.conj().T, lower=True, check_finite=False)
        return np.einsum("ij,ij->j", half, half.conj()).real

    def draw(self, rng: np.random.Generator) -> Array:
        """Draw coefficients.

        The Gaussian constrained realisation solves P x = h + Sigma^(-1/2) w0 + A^H N^(-1/2) w1; its two noise
        terms together have covariance P = L L^H, so they are drawn as one, L w, and x = mean + L^-H w.
        """
        n = len(self.mean)
        white = complex_normal(rng, (n,)) if self.is_complex else rng.standard_normal(n)
        return self.mean + solve_triangular(self.factor, white, lower=True, trans="C", check_finite=False)


def solve_posterior(normal: NormalEquations, prior: Prior) -> Posterior:
    """Combine data and prior.

    Parameters
    ----------
    normal : NormalEquations
        Summed over all rows and symmetrised.
    prior : Prior
        On the same coefficients.

    Raises
    ------
    InputError
        If data and prior together do not determine the coefficients.
    """
    kappa = 1.0 if normal.is_complex else 2.0
    if prior.log_det_precision is None and normal.n > normal.n_data * kappa:
        raise InputError(
            f"{normal.n} coefficients cannot be inferred from {normal.n_data} visibilities with a flat prior",
            field="[prior] kind",
            remedy="use fewer modes ([basis] n_modes), more data, or a prior that is not flat",
        )
    precision = kappa * normal.gram
    prior.add_precision(precision)
    factor = cholesky_lower(precision)
    source = kappa * normal.projection + prior.precision_times(prior.mean)
    half = solve_triangular(factor, source, lower=True, check_finite=False)
    mean = solve_triangular(factor, half, lower=True, trans="C", check_finite=False)

    log_evidence = None
    if prior.log_det_precision is not None:
        # Densities are exp(-q) for complex and exp(-q/2) for real coefficients: in both exp(-q/kappa).
        quadratic = kappa * normal.data_norm + np.vdot(prior.mean, prior.precision_times(prior.mean)).real
        quadratic -= np.vdot(half, half).real
        log_det = prior.log_det_precision - 2 * np.sum(np.log(np.diag(factor).real))
        log_evidence = float((log_det - quadratic) / kappa + normal.log_det_inv_noise - normal.n_data * np.log(np.pi))
    return Posterior(mean, factor, log_evidence)
