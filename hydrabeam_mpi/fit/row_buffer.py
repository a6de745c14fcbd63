"""Rows of several times together, so that the updates of a Gram matrix are large ones."""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.data.observation import Array, ComplexArray, FloatArray
from hydrabeam_mpi.fit.columns import Columns, RowSet
from hydrabeam_mpi.fit.equations import NormalEquations

CAPACITY = 512
"""Rows held before they are added: a rank-k update of so many runs as fast as one of more."""


class RowBuffer:
    """Collects rows of one block, with columns by group, so that the rank-k updates of its Gram matrix are large ones.

    Parameters
    ----------
    equations : NormalEquations
        Where full buffers are added.
    name : str
        Of the block.
    capacity : int
        Rows held before they are added.
    """

    def __init__(self, equations: NormalEquations, name: str, capacity: int = CAPACITY) -> None:
        self.equations, self.name, self.capacity = equations, name, capacity
        self._held: list[tuple[Array, ComplexArray, FloatArray]] = []

    def add(self, rows: Array, weighted_data: ComplexArray, weights: FloatArray) -> None:
        """Take rows, of which those without weight are left out.

        Parameters
        ----------
        rows : ndarray of complex, (Nrows, n); or of real, (2, Nrows, n)
            For real coefficients the real and the imaginary parts of the rows, one after the other.
        weighted_data : ndarray of complex, (Nrows,)
            Sum of w d over the data that share the row.
        weights : ndarray, (Nrows,)
            Sum of w over them.
        """
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
            together = RowSet(np.concatenate(weighted_data), np.concatenate(weights))
            values = np.concatenate(rows, axis=-2)
            self.equations.add_rows({self.name: Columns(together, values, by_group=True)})
