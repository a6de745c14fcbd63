"""Residuals whitened by their predictive distribution.

What the model is uncertain of is the same for redundant baselines and alike for others, so that a prediction that is
off is off for many rows at once. Dividing each row by its own standard deviation would leave that in, and chi^2 would
be far more uncertain than that of independent data. Of the rows of one time the part that the members of each group
have in common is therefore whitened together with that of the other groups. Errors of effects, which may be the same
at all times, are whitened over all rows: see `shared_errors`. Either takes the symmetric root, which changes a row as
little as whitening can.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.linalg import solve_triangular
from scipy.sparse import csr_array

from hydrabeam_mpi.data.observation import Array, BoolArray, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.eigen import eigen
from hydrabeam_mpi.inference.matrices import inverse_where_it_varies
from hydrabeam_mpi.inference.posterior import Posterior

LEAST_LEFT = 1e-9
"""Of the variance of a fitted row, that rounding errors leave: less is left of what only this time and the prior tell.
"""
COLUMNS_AT_ONCE = 128
"""Columns that are whitened together: products of so many run as fast as of more."""
ZERO_RTOL = 1e-12
"""Eigenvalues below this part of the largest count as zero: rounding errors of a thousand sums are no larger."""


@dataclass(frozen=True)
class TimeWhitener:
    """What whitens the rows of one time.

    What the members of a group have in common is whitened with that of the other groups; what else is in the rows is
    each row's own.

    Attributes
    ----------
    weights : ndarray, (Nbls,)
        Inverse variance of all that is each row's own, Jy^-2; zero for rows that do not count.
    group_weights : ndarray, (Ngroups,)
        Sums of these.
    gather : sparse array, (Ngroups, Nbls)
        Rows are unit vectors of what a group's members have in common.
    used : ndarray of int
        The groups of which something counts.
    vectors, scales : ndarray, (2 Nused, r) and (r,)
        Along these vectors of the components of used groups, all real parts first, rows are scaled.
    share : ndarray, (Nbls,)
        The model's share of the variance.
    variance : ndarray, (Nbls,)
        The model's own, Jy^2; zero where nothing of a group counts.
    """

    weights: FloatArray
    group_weights: FloatArray
    gather: csr_array
    used: IntArray
    vectors: FloatArray
    scales: FloatArray
    share: FloatArray
    variance: FloatArray

    @classmethod
    def of(cls, weights: FloatArray, member: IntArray, model_root: FloatArray, fitted: bool = False) -> Self:
        """Prepare to whiten rows.

        Parameters
        ----------
        weights : ndarray, (Nbls,)
            See above.
        member : ndarray of int, (Nbls,)
            Which design row belongs to each.
        model_root : ndarray, (r, 2 Ngroups)
            R with R^T R the covariance of the predictions; see `model_root`.
        fitted : bool, optional
            Whether these rows are among those that the model was fitted to. They are then whitened as the residuals of
            the model that all other times alone predict: with u the residuals over the noise and M the covariance of
            the predictions over that of the noise these are (1 - M)^-1/2 u, where rows that are not fitted have
            (1 + M)^-1/2 u.
        """
        n_groups = model_root.shape[1] // 2
        group_weights = np.asarray(np.bincount(member, weights, n_groups), dtype=float)
        used = np.flatnonzero(group_weights)
        own = np.sqrt(weights / np.where(group_weights > 0, group_weights, 1.0)[member])
        gather = csr_array((own, (member, np.arange(len(member)))), shape=(n_groups, len(member)))
        shared, variance = np.zeros((2, n_groups))
        if not len(used):  # a time that is wholly flagged
            empty = np.zeros((0, 0)), np.zeros(0)
            return cls(weights, group_weights, gather, used, *empty, shared[member], variance[member])
        # With all of HERA each of these is as large as the design of a time: one copy, scaled in place.
        root = model_root[:, np.concatenate([used, n_groups + used])]
        variance[used] = np.einsum("ij,ij->j", root, root).reshape(2, -1).sum(axis=0)
        root *= np.tile(np.sqrt(2 * group_weights[used]), 2)
        values, vectors = _spectrum(root)
        del root
        scales = 1 / np.sqrt(1 + values)
        if fitted:
            left = np.maximum(1 - values, LEAST_LEFT)
            values, scales = values / left, 1 / np.sqrt(left)
        by_part = np.einsum("ij,ij,j->i", vectors, vectors, values / (1 + values))
        shared[used] = 0.5 * (by_part[: len(used)] + by_part[len(used) :])
        share = own**2 * shared[member]
        return cls(weights, group_weights, gather, used, vectors, scales, share, variance[member])

    def rows(self, rows: ComplexArray) -> ComplexArray:
        """Whiten rows of baselines.

        Parameters
        ----------
        rows : ndarray of complex, (Nbls, k)
            Residuals, data minus prediction, or anything else of the rows in Jy; each column by itself.

        Returns
        -------
        ndarray of complex, (Nbls, k)
            Of residuals, with real and imaginary parts of variance one.
        """
        plain = np.sqrt(2 * self.weights)[:, np.newaxis] * rows
        return plain + self.gather.T @ self._change(self.gather @ plain)

    def of_groups(self, rows: ComplexArray) -> ComplexArray:
        """Whiten what all members of a group have alike, (Ngroups, k); returned as components along `gather`'s."""
        common = np.sqrt(2 * self.group_weights)[:, np.newaxis] * rows
        # In place, some columns after the others: with all of HERA all of them are hundreds of megabytes.
        for first in range(0, common.shape[1], COLUMNS_AT_ONCE):
            some = common[:, first : first + COLUMNS_AT_ONCE]
            some += self._change(some)
        return common

    def _change(self, common: ComplexArray) -> ComplexArray:
        """Return by what the components of groups change, both (Ngroups, k)."""
        change = np.zeros_like(common)
        parts = np.concatenate([common.real[self.used], common.imag[self.used]])
        changed = self.vectors @ ((self.scales - 1)[:, np.newaxis] * (self.vectors.T @ parts))
        n = len(self.used)
        change[self.used] = changed[:n] + 1j * changed[n:]
        return change


def _spectrum(root: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the eigenvalues of R^T R, none negative, and its eigenvectors; those of eigenvalue zero may be left out.

    With fewer rows than columns R R^T has the others, and is the smaller matrix.
    """
    if len(root) >= root.shape[1]:
        values, vectors = eigen(root.T @ root)
        return np.maximum(values, 0.0), vectors
    values, vectors = eigen(root @ root.T)
    told = values > ZERO_RTOL * values.max(initial=0.0)
    return values[told], root.T @ (vectors[:, told] / np.sqrt(values[told]))


def root_of(covariance: FloatArray) -> FloatArray:
    """Return R with R R^T the covariance, (q, q), so that no variance of what is made with it is negative."""
    try:
        return np.asarray(np.linalg.cholesky(covariance))
    except np.linalg.LinAlgError:
        # Parameters that are held, or know nothing beyond others, leave eigenvalues of zero.
        values, vectors = eigen(covariance)
        return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def root_by_shared(covariance: FloatArray, shared: BoolArray) -> FloatArray:
    """Return a root of a covariance, (q, q), by which shared parameters follow the first of all numbers alone.

    Rows are parameters as they come, and columns independent numbers, one for each parameter: those of shared ones
    stand where these do.
    """
    first, rest = np.flatnonzero(shared), np.flatnonzero(~shared)
    root, own = np.zeros_like(covariance), covariance[np.ix_(rest, rest)]
    of_first = covariance[np.ix_(first, first)]
    root[np.ix_(first, first)] = root_of(of_first)
    if len(first) and len(rest):
        follow = covariance[np.ix_(rest, first)] @ inverse_where_it_varies(of_first)
        root[np.ix_(rest, first)] = follow @ root[np.ix_(first, first)]
        own = own - follow @ of_first @ follow.T
    root[np.ix_(rest, rest)] = root_of(0.5 * (own + own.T))
    return root


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
    # A complex matrix has as many rows for its columns as both have in parts, which would take twice as long.
    if len(root) > root.shape[1]:
        root = np.asarray(np.linalg.qr(root, mode="r"))
    if posterior.is_complex:
        root = np.sqrt(0.5) * np.block([[root.real, -root.imag], [root.imag, root.real]])
    return np.asarray(root)
