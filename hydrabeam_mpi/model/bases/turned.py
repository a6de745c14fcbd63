"""The functions of a basis turned about the zenith: those of the other one of two identical feeds at right angles."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from hydrabeam_mpi.data.observation import Array, FloatArray, IntArray
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.model.bases.base import LinearBasis, NextModes


class Turned(LinearBasis):
    """The functions f_n(za, az - angle) of a basis f_n.

    Parameters
    ----------
    basis : LinearBasis
    angle : float
        Radians, from East through North.
    """

    title: ClassVar[str] = "turned"

    def __init__(self, basis: LinearBasis, angle: float) -> None:
        self.basis, self.angle = basis, angle
        self.n_modes, self.n_columns, self.is_complex = basis.n_modes, basis.n_columns, basis.is_complex

    def columns(self, za: FloatArray, az: FloatArray, out: FloatArray | None = None) -> FloatArray:
        """Evaluate the real columns; see :meth:`LinearBasis.columns`."""
        return self.basis.columns(za, (az - self.angle) % (2 * np.pi), out)

    def mix(self, rows: Array) -> Array:
        """Turn columns into functions; see :meth:`LinearBasis.mix`."""
        return self.basis.mix(rows)

    def column_coeffs(self, coeffs: Array) -> Array:
        """Return the equivalent coefficients of the columns, (..., n_columns)."""
        return self.basis.column_coeffs(coeffs)

    def amplitudes(self, coeffs: Array) -> FloatArray:
        """Return how large each coefficient is, (n_modes,)."""
        return self.basis.amplitudes(coeffs)

    def expected(self, amplitudes: FloatArray) -> FloatArray:
        """Return how large coefficients may be by those of a model beam, (n_modes,)."""
        return self.basis.expected(amplitudes)

    @property
    def orders(self) -> IntArray:
        """Radial and azimuthal order of each function, (n_modes, 2)."""
        return self.basis.orders

    def next_modes(self, amplitudes: FloatArray, n_before: int, most: int) -> NextModes | None:
        """Return the functions that the basis would have next, turned alike."""
        found = self.basis.next_modes(amplitudes, n_before, most)
        return found and replace(found, make=lambda: Turned(found.make(), self.angle))

    def with_more(self, other: LinearBasis) -> LinearBasis | None:
        """Return the basis of one's own functions and then those of another one that is turned alike."""
        if not isinstance(other, Turned) or other.angle != self.angle:
            return None
        both = self.basis.with_more(other.basis)
        return both and Turned(both, self.angle)

    def describe(self) -> dict[str, Any]:
        """Return kind, the description of the basis before it is turned, and by how much it is."""
        return {"kind": "turned", "parts": [self.basis.describe()], "angle": self.angle}

    @classmethod
    def from_settings(cls, settings: Mapping[str, Any]) -> LinearBasis:
        """No job asks for one: the data of another feed make it."""
        raise InputError("is no basis to begin with", field="[basis] kind", remedy="name the one that is turned")

    @classmethod
    def from_description(cls, description: Mapping[str, Any]) -> Turned:
        """Restore it from a description in which the basis is restored already; ValueError where it is none."""
        (basis,) = description["parts"]
        return cls(basis, float(description["angle"]))
