"""A basis with one more function: all that a model beam has beyond the others.

A basis of few functions leaves something over of the model beam itself, which is known before there are data. What is
not known is how the true beam differs from the model, which is many times less. With the rest as a function of its own
the first does not count as an error of the model any more.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from hydrabeam_mpi.data.observation import Array, FloatArray, IntArray
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.model.bases.base import LinearBasis, NextModes
from hydrabeam_mpi.model.bases.polar_table import HORIZON, PolarTable, radii

PER_UNIT, N_AZ = 320, 720
"""Nodes of the table of the rest: every 0.4 to 0.5 degrees, finer than what files of beams tell."""


def rest_nodes() -> tuple[FloatArray, FloatArray]:
    """Return zenith angle and azimuth (radians) of the nodes of a rest, (Nnodes,) each; none is below the horizon."""
    radius = radii(PER_UNIT)
    za = 2 * np.arcsin(np.minimum(radius, HORIZON))
    az = np.linspace(0, 2 * np.pi, N_AZ, endpoint=False)
    both = np.meshgrid(np.minimum(za, np.pi / 2), az, indexing="ij")
    return both[0].ravel(), both[1].ravel()


class WithRest(LinearBasis):
    """The functions of a real or complex basis, and after them a real one that is given at `rest_nodes`.

    Parameters
    ----------
    basis : LinearBasis
    values : ndarray, (Nnodes,)
        Of the last function; kept in single precision.
    """

    title: ClassVar[str] = "with rest"

    def __init__(self, basis: LinearBasis, values: FloatArray) -> None:
        self.basis, self.values = basis, np.asarray(values, dtype=np.float32)
        self.n_modes, self.n_columns = basis.n_modes + 1, basis.n_columns + 1
        self.is_complex = basis.is_complex

    def rest(self, za: FloatArray, az: FloatArray) -> FloatArray:
        """Evaluate the last function up to the horizon, (Npoints,)."""
        az = np.asarray(az) % (2 * np.pi)
        return self._table(np.minimum(za, np.pi / 2), az)

    @cached_property
    def _table(self) -> PolarTable:
        """Of the last function, made once."""
        return PolarTable(self.values.reshape(-1, N_AZ).astype(float), PER_UNIT)

    def columns(self, za: FloatArray, az: FloatArray, out: FloatArray | None = None) -> FloatArray:
        """Evaluate the real columns, the rest last; see :meth:`LinearBasis.columns`."""
        if out is None:
            out = np.empty((self.n_columns, len(za)))
        self.basis.columns(za, az, out[:-1])
        out[-1] = self.rest(za, az)
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
        za = 2 * np.arcsin(np.minimum(radii(per_unit), HORIZON))
        az = np.linspace(0, 2 * np.pi, n_az, endpoint=False)
        grid = (one.ravel() for one in np.meshgrid(za, az, indexing="ij"))
        rest = self.rest(*grid).reshape(len(za), n_az)
        return self.basis.at_nodes(coeffs[:-1], per_unit, n_az) + coeffs[-1].real * rest

    def __getstate__(self) -> dict[str, Any]:
        """Leave out what is made again where it is needed, and is larger than all else."""
        return {name: value for name, value in vars(self).items() if name != "_table"}

    def describe(self) -> dict[str, Any]:
        """Return kind, the description of the basis, and the values at the nodes, single precision in base 64."""
        values = base64.b64encode(self.values.astype("<f4").tobytes()).decode()
        return {"kind": "with_rest", "parts": [self.basis.describe()], "values": values}

    @classmethod
    def from_settings(cls, settings: Mapping[str, Any]) -> LinearBasis:
        """No job asks for one by its kind: `[basis] rest` does."""
        raise InputError("is no basis to begin with", field="[basis] kind", remedy="name the one that has the rest")

    @classmethod
    def from_description(cls, description: Mapping[str, Any]) -> WithRest:
        """Restore it from a description in which the basis is restored already; ValueError where it is none."""
        (basis,) = description["parts"]
        values = np.frombuffer(base64.b64decode(description["values"], validate=True), "<f4")
        if len(values) != len(rest_nodes()[0]) or not np.isfinite(values).all():
            raise ValueError("not one number for each node")
        return cls(basis, values)
