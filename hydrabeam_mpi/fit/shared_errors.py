"""Rows whitened by what they share of the errors of some parameters, over times and over channels.

With the columns C_c of a channel's parameters, whose errors have covariance S_c, its residuals, as each time whitens
them, have covariance 1 + C_c S_c C_c^T. Of parameters x that channels share the errors are the same in all of them,
and given x those of the others are of one channel alone: they follow x by A_c and have a covariance R_c of their own.
So the rows of each channel are whitened by R_c, and then those of all channels by what x adds to them, 1 + D S_x D^T
with D the columns of x, which the others follow, whitened by R_c. The roots are symmetric ones, and as rows enter only
by C_c^T C_c and C_c^T z, which are sums over rows, they may be on any rank.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy.sparse import csr_array

from hydrabeam_mpi.data.observation import BoolArray, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.eigen import eigen
from hydrabeam_mpi.fit.marginal import in_parts
from hydrabeam_mpi.fit.row_buffer import CAPACITY
from hydrabeam_mpi.fit.whitening import TimeWhitener, root_by_shared, root_of
from hydrabeam_mpi.mpi import Comm, allreduce_sum


@dataclass(frozen=True)
class Felt:
    """How the predictions of one time feel some parameters.

    Attributes
    ----------
    own : ndarray of complex, (Nbls, k)
        By those that members of a group feel each in its own way.
    of_groups : ndarray of complex, (Ngroups, l)
        By those that they feel alike. There are fewer groups than baselines, and most effects of the sky are such.
    is_of_groups : ndarray of bool, (k + l,)
        Which of all are the latter.
    """

    own: ComplexArray
    of_groups: ComplexArray
    is_of_groups: BoolArray


class SharedErrors:
    """What the rows of one channel share of the errors of some parameters.

    Parameters
    ----------
    covariance : ndarray, (q, q)
        Of the parameters; ``root`` is its root.
    """

    def __init__(self, covariance: FloatArray) -> None:
        self.covariance, self.root = covariance, root_of(covariance)
        # Of the columns as they are: those in units of their errors would be a product of large matrices each time.
        self.gram = np.zeros((len(covariance), len(covariance)))
        self.projection = np.zeros(len(covariance))
        self._kept: list[tuple[csr_array, Felt]] = []
        self._held: list[list[FloatArray]] = []

    def add(self, time: TimeWhitener, z: ComplexArray, felt: Felt) -> None:
        """Take the residuals of one time as it whitens them, (Nbls,), and how its rows feel the parameters."""
        felt = replace(felt, own=time.rows(felt.own), of_groups=time.of_groups(felt.of_groups))
        self._kept.append((time.gather, felt))
        parts = felt.own, time.gather @ felt.own, felt.of_groups, z, time.gather @ z
        self._held.append([in_parts(one) for one in parts])
        if sum(len(own) for own, *_ in self._held) >= CAPACITY:
            self._flush()

    def _flush(self) -> None:
        """Add the products of all rows so far to the sums: those of several times at once take less time."""
        if not self._held:
            return
        of_groups = self._kept[-1][1].is_of_groups
        one, two = np.flatnonzero(~of_groups), np.flatnonzero(of_groups)
        own, common, groups, z, common_z = (np.concatenate(parts) for parts in zip(*self._held, strict=True))
        self._held = []
        mixed = common.T @ groups
        self.gram[np.ix_(one, one)] += own.T @ own
        self.gram[np.ix_(one, two)] += mixed
        self.gram[np.ix_(two, one)] += mixed.T
        self.gram[np.ix_(two, two)] += groups.T @ groups
        self.projection[one] += own.T @ z
        self.projection[two] += groups.T @ common_z

    def complete(self, comm: Comm) -> Self:
        """Sum over the ranks that have rows of the channel, and return itself. Collective: all ranks of `comm`."""
        self._flush()
        allreduce_sum(comm, self.gram)
        allreduce_sum(comm, self.projection)
        return self

    def changes(self, coefficients: FloatArray) -> list[ComplexArray]:
        """Return what is to be added to the rows of each time, (Nbls,), with those of `whitening_coefficients`."""
        return [
            felt.own @ coefficients[~felt.is_of_groups] + gather.T @ (felt.of_groups @ coefficients[felt.is_of_groups])
            for gather, felt in self._kept
        ]


def whitening_coefficients(
    channels: Sequence[SharedErrors], shared: BoolArray, world: Comm, counts: bool
) -> tuple[list[FloatArray], list[float]]:
    """Return by how many of each column the rows change that whiten them, and how many parameters they feel.

    Collective: all ranks of ``world``.

    Parameters
    ----------
    channels : list of SharedErrors
        This rank's, complete.
    shared : ndarray of bool, (q,)
        Which parameters the channels share.
    world : Comm
        Ranks that have channels between them.
    counts : bool
        Whether this rank speaks for its channels: one of those that have rows of the same does.

    Returns
    -------
    coefficients : list of ndarray, (q,)
        Of each channel's columns.
    felt : list of float
        Of each channel; of shared parameters the channel's part.
    """
    given = [_Given.of(one, shared) for one in channels]
    n = int(np.count_nonzero(shared))
    gram, projection = np.zeros((n, n)), np.zeros(n)
    for one in given if counts else ():
        gram += one.gram
        projection += one.projection
    allreduce_sum(world, gram)
    allreduce_sum(world, projection)
    values, vectors = _spectrum(gram)
    common, left = vectors @ (_change(values) * (vectors.T @ projection)), (vectors / (1 + values)) @ vectors.T
    return [one.coefficients(common) for one in given], [one.n_felt(left) for one in given]


@dataclass(frozen=True)
class _Given:
    """A channel's rows whitened by the errors that it does not share, given those that it does.

    Errors are numbers of variance one, by which parameters follow as `root_by_shared` says: those of shared parameters
    first of all, so that the others add what is the channel's own.

    Attributes
    ----------
    root : ndarray, (q, q)
        How the parameters follow the numbers.
    products, projection_of_all : ndarray, (q, q) and (q,)
        Of the columns of the numbers with each other and with the residuals.
    own, common : ndarray of int
        The numbers of the channel alone and the n shared ones.
    gram, projection : ndarray, (n, n) and (n,)
        Products of the columns of the shared ones with each other and with the residuals, whitened.
    change, left : ndarray, (Nown, Nown)
        By which combinations of the own columns rows are whitened, and the covariance of these numbers where the rows
        are known.
    """

    root: FloatArray
    products: FloatArray
    projection_of_all: FloatArray
    own: IntArray
    common: IntArray
    gram: FloatArray
    projection: FloatArray
    change: FloatArray
    left: FloatArray

    @classmethod
    def of(cls, errors: SharedErrors, shared: BoolArray) -> Self:
        """Work them out; see the top of this module."""
        own, common = np.flatnonzero(~shared), np.flatnonzero(shared)
        root = root_by_shared(errors.covariance, shared)
        products, projection = root.T @ errors.gram @ root, root.T @ errors.projection
        values, vectors = _spectrum(products[np.ix_(own, own)])
        left, across = (vectors / (1 + values)) @ vectors.T, products[np.ix_(own, common)]
        return cls(
            root,
            products,
            projection,
            own,
            common,
            products[np.ix_(common, common)] - across.T @ left @ across,
            projection[common] - across.T @ left @ projection[own],
            (vectors * _change(values)) @ vectors.T,
            left,
        )

    def coefficients(self, common: FloatArray) -> FloatArray:
        """Return those of all columns, (q,), where those of the shared numbers' whitened columns are given, (n,)."""
        found = np.zeros(len(self.root))
        found[self.common] = common
        found[self.own] = self.change @ (self.projection_of_all[self.own] + self.products[self.own] @ found)
        return self.root @ found

    def n_felt(self, common: FloatArray) -> float:
        """Return how many parameters the rows feel, where ``common``, (n, n), is left of the errors of the shared ones.

        That is the trace of the products times the covariance of all numbers where the rows of all channels are known.
        """
        across = self.products[np.ix_(self.own, self.common)]
        follow = np.zeros((len(self.root), len(self.common)))
        follow[self.common], follow[self.own] = np.eye(len(self.common)), -self.left @ across
        of_own = np.sum(self.products[np.ix_(self.own, self.own)] * self.left)
        return float(of_own + np.sum((follow.T @ self.products @ follow) * common))


def _spectrum(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return eigenvalues, none negative, and eigenvectors."""
    values, vectors = eigen(matrix)
    return np.maximum(values, 0.0), vectors


def _change(values: FloatArray) -> FloatArray:
    """Return ((1 + v)^-1/2 - 1) / v."""
    values = np.maximum(values, 1e-300)
    return np.asarray(np.expm1(-0.5 * np.log1p(values)) / values)
