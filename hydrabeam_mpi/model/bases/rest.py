"""One function that is given by its values: all that a model beam has beyond others.

Between its nodes it is smooth. A model beam that is interpolated between the pixels of a HEALPix map is not: it bends
at every line between their centres, which a table cannot follow. Of such a beam the map itself is kept as well.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.model.bases.base import LinearBasis
from hydrabeam_mpi.model.bases.healpix_map import HealpixMap, from_base64, in_base64
from hydrabeam_mpi.model.bases.polar_table import HORIZON, PolarTable, radii

PER_UNIT, N_AZ = 320, 720
"""Nodes of the table of the rest: every 0.4 to 0.5 degrees, finer than what files of beams tell."""


def rest_nodes(per_unit: int = PER_UNIT, n_az: int = N_AZ) -> tuple[FloatArray, FloatArray]:
    """Return zenith angle and azimuth (radians) of the nodes of a rest, (Nnodes,) each; none is below the horizon.

    Or those of a table with other numbers of nodes.
    """
    za = 2 * np.arcsin(np.minimum(radii(per_unit), HORIZON))
    az = np.linspace(0, 2 * np.pi, n_az, endpoint=False)
    both = np.meshgrid(np.minimum(za, np.pi / 2), az, indexing="ij")
    return both[0].ravel(), both[1].ravel()


def _continued(values: FloatArray, per_unit: int) -> FloatArray:
    """Return values at a table's nodes, (Nradii, Naz), that go on smoothly beyond the horizon: they do not bend there.

    As cubics through the last four above it.
    """
    n_up = int(per_unit * HORIZON) + 1
    known, beyond = np.arange(-3.0, 1.0), np.arange(1.0, len(values) - n_up + 1)
    weights = np.vander(beyond, 4) @ np.linalg.inv(np.vander(known, 4))
    return np.concatenate([values[:n_up], weights @ values[n_up - 4 : n_up]])


class Rest(LinearBasis):
    """A single real function that is given at `rest_nodes`, and known up to the horizon.

    Parameters
    ----------
    values : ndarray, (Nnodes,)
        Kept in single precision.
    samples : HealpixMap, optional
        What it has of the map that the model beam is interpolated from, `HealpixMap.times` a factor: all of it that is
        not smooth.
    """

    title: ClassVar[str] = "rest"
    n_modes = n_columns = 1
    is_complex = False

    def __init__(self, values: Array, samples: HealpixMap | None = None) -> None:
        self.values, self.samples = np.asarray(values, dtype=np.float32), samples
        self._at_nodes: dict[tuple[int, int], FloatArray] = {}
        """Of the tables that were asked for, which is one of each basis that it is beside."""

    @cached_property
    def _table(self) -> PolarTable:
        """Of the function less its map, made once."""
        values = self.values.astype(float)
        if self.samples is not None:
            values -= self.samples(*rest_nodes())
        return PolarTable(_continued(values.reshape(-1, N_AZ), PER_UNIT), PER_UNIT)

    def columns(self, za: FloatArray, az: FloatArray, out: FloatArray | None = None) -> FloatArray:
        """Evaluate the function, (1, Npoints); see :meth:`LinearBasis.columns`."""
        above, around = np.minimum(za, np.pi / 2), np.asarray(az) % (2 * np.pi)
        values = self._table(above, around)
        if self.samples is not None:
            values = values + self.samples(above, around)
        if out is None:
            return values[np.newaxis]
        out[0] = values
        return out

    @property
    def table_nodes(self) -> tuple[int, int]:
        """Its own."""
        return PER_UNIT, N_AZ

    def at_nodes(self, coeffs: Array, per_unit: int, n_az: int) -> FloatArray:
        """Evaluate a multiple of it at a table's nodes, (Nradii, Naz)."""
        if (per_unit, n_az) not in self._at_nodes:
            values = self.columns(*rest_nodes(per_unit, n_az))[0].reshape(-1, n_az)
            self._at_nodes[per_unit, n_az] = _continued(values, per_unit)
        return np.asarray(coeffs[0]).real * self._at_nodes[per_unit, n_az]

    def __getstate__(self) -> dict[str, Any]:
        """Leave out what is made again where it is needed, and is larger than all else."""
        return {**{name: value for name, value in vars(self).items() if name != "_table"}, "_at_nodes": {}}

    def describe(self) -> dict[str, Any]:
        """Return kind, the values at the nodes, single precision in base 64, and the map, where there is one."""
        described = {"kind": "rest", "values": in_base64(self.values)}
        return described if self.samples is None else {**described, "samples": self.samples.describe()}

    @classmethod
    def from_settings(cls, settings: Mapping[str, Any]) -> LinearBasis:
        """No job asks for one by its kind: `[basis] rest` does."""
        raise InputError("is no basis to begin with", field="[basis] kind", remedy="name the one that has the rest")

    @classmethod
    def from_description(cls, description: Mapping[str, Any]) -> Rest:
        """Restore it from a description; ValueError where it is none."""
        values = from_base64(description["values"])
        if len(values) != len(rest_nodes()[0]) or not np.isfinite(values).all():
            raise ValueError("not one number for each node")
        samples = description.get("samples")
        return cls(values, None if samples is None else HealpixMap.from_description(samples))
