"""Residuals whitened by their predictive distribution.

What the model is uncertain of is the same for redundant baselines and alike for others, so that a prediction that is
off is off for many rows at once. Dividing each row by its own standard deviation would leave that in, and chi^2 would
be far more uncertain than that of independent data. Of the rows of one time the part that the members of each group
have in common is therefore whitened together with that of the other groups. Errors of effects, which may be the same
at all times, are whitened over all rows. Either takes the symmetric root, which changes a row as little as whitening
can.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy.linalg import solve_triangular
from scipy.sparse import csr_array

from hydrabeam_mpi.data.observation import Array, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.inference.posterior import Posterior

LEAST_LEFT = 1e-9
"""Of the variance of a fitted row, that rounding errors leave: less is left of what only this time and the prior tell.
"""
ZERO_RTOL = 1e-12
"""Eigenvalues below this part of the largest count as zero: rounding errors of a thousand sums are no larger."""


def whiten_time(
    rows: ComplexArray, weights: FloatArray, member: IntArray, model_root: FloatArray, fitted: bool = False
) -> tuple[ComplexArray, FloatArray, float, FloatArray]:
    """Whiten the rows of one time.

    Parameters
    ----------
    rows : ndarray of complex, (Nbls, k)
        Residuals, data minus prediction, or anything else of the rows in Jy; each column by itself.
    weights : ndarray, (Nbls,)
        Inverse variance of all that is each row's own, Jy^-2; zero for rows that do not count.
    member : ndarray of int, (Nbls,)
        Which design row belongs to each.
    model_root : ndarray, (r, 2 Ngroups)
        R with R^T R the covariance of the predictions; see `model_root`.
    fitted : bool, optional
        Whether these rows are among those that the model was fitted to. They are then whitened as the residuals of the
        model that all other times alone predict: with u the residuals over the noise and M the covariance of the
        predictions over that of the noise these are (1 - M)^-1/2 u, where rows that are not fitted have (1 + M)^-1/2 u.

    Returns
    -------
    z : ndarray of complex, (Nbls, k)
        Of residuals, with real and imaginary parts of variance one.
    share : ndarray, (Nbls,)
        The model's share of the variance.
    log_spread : float
        Half of the logarithm of the covariance's determinant, in units of the noise.
    variance : ndarray, (Nbls,)
        The model's own, Jy^2; zero where nothing of a group counts.
    """
    n_groups = model_root.shape[1] // 2
    group_weights = np.bincount(member, weights, n_groups)
    used = np.flatnonzero(group_weights)
    if not len(used):  # a time that is wholly flagged
        return np.zeros_like(rows), np.zeros(len(member)), 0.0, np.zeros(len(member))
    root = np.tile(np.sqrt(2 * group_weights[used]), 2)
    # Unit vectors of what a group's members have in common, and the components along them.
    own = np.sqrt(weights / np.where(group_weights > 0, group_weights, 1.0)[member])
    gather = csr_array((own, (member, np.arange(len(member)))), shape=(n_groups, len(member)))
    plain = np.sqrt(2 * weights)[:, np.newaxis] * rows
    common = (gather @ plain)[used]
    model_root = model_root[:, np.concatenate([used, n_groups + used])]
    values, vectors = _spectrum(model_root * root)
    scales = 1 / np.sqrt(1 + values)
    if fitted:
        left = np.maximum(1 - values, LEAST_LEFT)
        values, scales = values / left, 1 / np.sqrt(left)
    parts = np.concatenate([common.real, common.imag])
    changed = vectors @ ((scales - 1)[:, np.newaxis] * (vectors.T @ parts))
    change = np.zeros((n_groups, rows.shape[1]), dtype=complex)
    change[used] = changed[: len(used)] + 1j * changed[len(used) :]
    shared = np.zeros(n_groups)
    by_part = np.square(vectors) @ (values / (1 + values))
    shared[used] = 0.5 * (by_part[: len(used)] + by_part[len(used) :])
    variance = np.zeros(n_groups)
    variance[used] = np.sum(model_root**2, axis=0).reshape(2, -1).sum(axis=0)
    log_spread = 0.5 * float(np.log1p(values).sum())
    return plain + gather.T @ change, own**2 * shared[member], log_spread, variance[member]


def _spectrum(root: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the eigenvalues of R^T R, none negative, and its eigenvectors; those of eigenvalue zero may be left out.

    With fewer rows than columns R R^T has the others, and is the smaller matrix.
    """
    if len(root) >= root.shape[1]:
        values, vectors = np.linalg.eigh(root.T @ root)
        return np.maximum(values, 0.0), vectors
    values, vectors = np.linalg.eigh(root @ root.T)
    told = values > ZERO_RTOL * values.max(initial=0.0)
    return values[told], root.T @ (vectors[:, told] / np.sqrt(values[told]))


def root_of(covariance: FloatArray) -> FloatArray:
    """Return R with R R^T the covariance, (q, q), so that no variance of what is made with it is negative."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


class SharedErrors:
    """Whitens rows of many times by what they share of the errors of some parameters.

    With the columns B of these parameters, in units of their posterior errors, the whitened residuals have covariance
    1 + B B^T, whose root needs only B^T B and B^T z: sums over rows, hence over ranks.

    Parameters
    ----------
    covariance : ndarray, (q, q)
        Of the parameters.
    """

    def __init__(self, covariance: FloatArray) -> None:
        self._root = root_of(covariance)
        # Of the columns as they are: those in units of their errors would be a product of large matrices each time.
        self.gram = np.zeros((len(covariance), len(covariance)))
        self.projection = np.zeros(len(covariance))
        self._kept: list[FloatArray] = []

    def add(self, z: ComplexArray, columns: ComplexArray) -> None:
        """Take the rows of one time, (Nbls,) and (Nbls, q), whitened by all else."""
        parts = np.concatenate([columns.real, columns.imag])
        self._kept.append(parts)
        self.gram += parts.T @ parts
        self.projection += parts.T @ np.concatenate([z.real, z.imag])

    @cached_property
    def _spectrum(self) -> tuple[FloatArray, FloatArray]:
        """Eigenvalues, none negative, and eigenvectors of B^T B, once the sums are complete."""
        values, vectors = np.linalg.eigh(self._root.T @ self.gram @ self._root)
        return np.maximum(values, 0.0), vectors

    def changes(self) -> list[ComplexArray]:
        """Return what is to be added to the rows of each time, (Nbls,), once the sums are complete."""
        values, vectors = self._spectrum
        values = np.maximum(values, 1e-12 * max(float(values.max(initial=0.0)), 1e-300))
        factor = (1 / np.sqrt(1 + values) - 1) / values
        coefficients = self._root @ (vectors @ (factor * (vectors.T @ (self._root.T @ self.projection))))
        parts = [(columns @ coefficients).reshape(2, -1) for columns in self._kept]
        return [real + 1j * imag for real, imag in parts]

    @property
    def n_shared(self) -> float:
        """How many parameters the predictions feel."""
        values, _ = self._spectrum
        return float(np.sum(values / (1 + values)))

    @property
    def log_spread(self) -> float:
        """Half of the logarithm of the covariance's determinant."""
        return 0.5 * float(np.log1p(self._spectrum[0]).sum())


def model_root(posterior: Posterior, design: Array) -> FloatArray:
    """Return R, (r, 2 Ngroups), with R^T R the covariance of a time's predictions, all real parts first.

    It has as many rows as there are parts of coefficients, or of predictions if these are fewer: of all of HERA the
    covariance itself would be one of 16,000 numbers with each other.

    Parameters
    ----------
    posterior : Posterior
        Of the coefficients.
    design : ndarray
        (2, Ngroups, n) real and imaginary parts for real coefficients, or (Ngroups, n) for complex ones.
    """
    rows = design.reshape(-1, design.shape[-1])
    root = solve_triangular(posterior.factor, rows.conj().T, lower=True, check_finite=False)
    if posterior.is_complex:
        root = np.sqrt(0.5) * np.block([[root.real, -root.imag], [root.imag, root.real]])
    return np.asarray(root if len(root) <= root.shape[1] else np.linalg.qr(root, mode="r"))
