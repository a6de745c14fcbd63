"""A basis with one more function: all that a model beam has beyond the others.

A basis of few functions leaves something over of the model beam itself, which is known before there are data. What is
not known is how the true beam differs from the model, which is many times less. With the rest as a function of its own
the first does not count as an error of the model any more.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from hydrabeam_mpi.data.observation import Array, FloatArray, IntArray
from hydrabeam_mpi.model.bases.base import LinearBasis, NextModes
from hydrabeam_mpi.model.bases.rest import N_AZ, PER_UNIT, Rest


class WithRest(LinearBasis):
    """The functions of a real or complex basis, and after them a real one.

    Parameters
    ----------
    basis : LinearBasis
    last : Rest
    """

    title: ClassVar[str] = "with rest"

    def __init__(self, basis: LinearBasis, last: Rest) -> None:
        self.basis, self.last = basis, last
        self.n_modes, self.n_columns = basis.n_modes + 1, basis.n_columns + 1
        self.is_complex = basis.is_complex

    def rest(self, za: FloatArray, az: FloatArray) -> FloatArray:
        """Evaluate the last function up to the horizon, (Npoints,)."""
        return self.last.columns(za, az)[0]

    def columns(self, za: FloatArray, az: FloatArray, out: FloatArray | None = None) -> FloatArray:
        """Evaluate the real columns, the rest last; see :meth:`LinearBasis.columns`."""
        if out is None:
            out = np.empty((self.n_columns, len(za)))
        self.basis.columns(za, az, out[:-1])
        self.last.columns(za, az, out[-1:])
        return out

    def mix(self, rows: Array) -> Array:
        """Turn columns, (..., n_columns), into functions, (..., n_modes)."""
        return np.concatenate([self.basis.mix(rows[..., :-1]), rows[..., -1:]], axis=-1)

    def column_coeffs(self, coeffs: Array) -> Array:
        """Return the equivalent coefficients of the columns, (..., n_columns)."""
        return np.concatenate([self.basis.column_coeffs(coeffs[..., :-1]), coeffs[..., -1:]], axis=-1)

    def synthesize(self, coeffs: Array, za: FloatArray, az: FloatArray) -> Array:
        """Evaluate the beam, (Npoints,), each part in its own way."""
        return np.asarray(self.basis.synthesize(coeffs[:-1], za, az) + coeffs[-1] * self.rest(za, az))

    def amplitudes(self, coeffs: Array) -> FloatArray:
        """Return how large each coefficient is, (n_modes,)."""
        return np.append(self.basis.amplitudes(coeffs[:-1]), abs(coeffs[-1]))

    def expected(self, amplitudes: FloatArray) -> FloatArray:
        """Return how large coefficients may be by those of a model beam, (n_modes,): of the rest, as it is."""
        return np.append(self.basis.expected(amplitudes[:-1]), amplitudes[-1])

    @property
    def orders(self) -> IntArray:
        """Radial and azimuthal order of each function, (n_modes, 2): the rest is beyond all others, next to none."""
        orders = self.basis.orders
        return np.concatenate([orders, [[orders[:, 0].max() + 2, 0]]])

    def next_modes(self, amplitudes: FloatArray, n_before: int, most: int) -> NextModes | None:
        """Return the functions that the basis would have next without the rest: what of it is not as in the model."""
        return self.basis.next_modes(amplitudes[:-1], n_before, most)

    @property
    def n_rings(self) -> int:
        """As many as the basis needs."""
        return self.basis.n_rings

    @property
    def table_nodes(self) -> tuple[int, int] | None:
        """As many as the basis needs, and the rest; none where the basis has no table, or goes on otherwise."""
        needed = None if self.basis.through_zenith else self.basis.table_nodes
        return needed and (max(needed[0], PER_UNIT), max(needed[1], N_AZ))

    def at_nodes(self, coeffs: Array, per_unit: int, n_az: int) -> FloatArray:
        """Evaluate a beam at a table's nodes, (Nradii, Naz)."""
        return self.basis.at_nodes(coeffs[:-1], per_unit, n_az) + self.last.at_nodes(coeffs[-1:], per_unit, n_az)

    def describe(self) -> dict[str, Any]:
        """Return kind, the description of the basis, and what describes the rest."""
        return {**self.last.describe(), "kind": "with_rest", "parts": [self.basis.describe()]}

    @classmethod
    def from_settings(cls, settings: Mapping[str, Any]) -> LinearBasis:
        """No job asks for one by its kind: `[basis] rest` does."""
        return Rest.from_settings(settings)

    @classmethod
    def from_description(cls, description: Mapping[str, Any]) -> WithRest:
        """Restore it from a description in which the basis is restored already; ValueError where it is none."""
        (basis,) = description["parts"]
        return cls(basis, Rest.from_description(description))
