"""The columns of blocks of unknowns at some rows of the data, and their products.

Redundant baselines share the columns of a beam that all antennas have in common. Such columns are given by group, and
the data of a group's rows are summed before; columns of antennas or of single baselines are given by row.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from scipy.sparse import csr_array, diags_array, issparse

from hydrabeam_mpi.data.observation import Array, ComplexArray, FloatArray, IntArray

DENSE = 0.05
"""Part of the entries that are not zero, beyond which the product of dense matrices takes less time."""
Matrix = Any
"""A NumPy array or a SciPy sparse one."""


class RowSet:
    """Rows of data that are added together.

    Parameters
    ----------
    weighted_data : ndarray of complex, (Nrows,)
        w d; or the sum of it over data that share all their columns.
    weights : ndarray, (Nrows,)
        w, or its sum over these data.
    member : ndarray of int, (Nrows,), optional
        To which group each row belongs; by default each is a group of its own.
    n_groups : int, optional
    """

    def __init__(
        self,
        weighted_data: ComplexArray,
        weights: FloatArray,
        member: IntArray | None = None,
        n_groups: int = 0,
    ) -> None:
        self.weighted_data, self.weights = weighted_data, weights
        self._gather = None
        if member is not None:
            ones = np.ones(len(member))
            self._gather = csr_array((ones, (member, np.arange(len(member)))), shape=(n_groups, len(member)))

    def summed(self, by_row: Matrix) -> Matrix:
        """Sum over the rows of each group, (Nrows, ...) to (Ngroups, ...)."""
        return by_row if self._gather is None else self._gather @ by_row

    @cached_property
    def group_data(self) -> ComplexArray:
        """Sum of w d over each group, (Ngroups,)."""
        return np.asarray(self.summed(self.weighted_data))

    @cached_property
    def group_weights(self) -> FloatArray:
        """Sum of w over each group, (Ngroups,)."""
        return np.asarray(self.summed(self.weights))


class Columns:
    """A block's columns at the rows of a set.

    Parameters
    ----------
    rows : RowSet
    values : ndarray or sparse array
        (Nrows, n), or (Ngroups, n) with ``by_group``. Of a block with real unknowns by group also (2, Ngroups, n): real
        parts, then imaginary ones.
    by_group : bool
    """

    def __init__(self, rows: RowSet, values: Matrix, by_group: bool) -> None:
        self.rows, self.values, self.by_group = rows, values, by_group
        self.in_parts = values.ndim == 3

    @cached_property
    def weighted(self) -> Matrix:
        """Columns times w, by row where they are so."""
        weights = self.rows.group_weights if self.by_group else self.rows.weights
        if issparse(self.values):
            return diags_array(weights) @ self.values
        return weights[:, np.newaxis] * self.values

    @cached_property
    def group_weighted(self) -> Matrix:
        """Columns times w, summed over each group."""
        return self.weighted if self.by_group else self.rows.summed(self.weighted)

    def times_data(self, is_complex: bool) -> Array:
        """Return A^H N^-1 d, its real part for real unknowns, (n,)."""
        data = self.rows.group_data if self.by_group else self.rows.weighted_data
        if self.in_parts:
            real, imag = self.values
            return np.asarray(real.T @ data.real + imag.T @ data.imag)
        # What is conjugated is the smaller one.
        product = np.asarray(self.values.T @ data.conj()).conj()
        return product if is_complex else product.real

    def times(self, other: Columns, is_complex: bool) -> Array:
        """Return A_1^H N^-1 A_2, (n_1, n_2); its real part unless unknowns of either are complex."""
        if other.in_parts and not self.in_parts:
            return other.times(self, is_complex).conj().T
        if self.in_parts:
            real, imag = (part.T for part in self.values)
            if other.in_parts:
                return _product(real, other.weighted[0]) + _product(imag, other.weighted[1])
            two = other.group_weighted
            product = _product(real, two.real) + _product(imag, two.imag)
            return product + 1j * (_product(real, two.imag) - _product(imag, two.real)) if is_complex else product
        if self.by_group:
            one, two = self.values, other.group_weighted
        elif other.by_group:
            one, two = self.group_weighted, other.values
        else:
            one, two = self.values, other.weighted
        if is_complex or issparse(one) or issparse(two):
            product = _adjoint_product(one, two)
            return product if is_complex else product.real
        # Half of the work.
        return np.asarray(one.real.T @ two.real + one.imag.T @ two.imag)


def _adjoint_product(one: Matrix, two: Matrix) -> Array:
    """Return one^H two; the one with fewer columns is conjugated, which takes a copy."""
    if one.shape[1] <= two.shape[1]:
        return _product(one.conj().T, two)
    return _product(one.T, two.conj()).conj()


def _product(one: Matrix, two: Matrix) -> Array:
    """Return a product of dense or sparse matrices as a dense one."""
    if issparse(two) and not issparse(one):
        if two.nnz > DENSE * two.shape[0] * two.shape[1]:
            return np.asarray(one @ two.toarray())
        return np.asarray((two.T @ one.T).T)
    product = one @ two
    return np.asarray(product.toarray() if issparse(product) else product)
