"""Functions of several bases side by side, such as a basis and the next ones of another kind."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from hydrabeam_mpi.data.observation import Array, FloatArray, IntArray
from hydrabeam_mpi.data.partition import spans
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.model.bases.base import LinearBasis


def join(parts: Sequence[LinearBasis], kept: Iterable[int] | None = None) -> LinearBasis:
    """Return all or some functions of some bases, as `Joined` does or as a plain basis where they make one."""
    made = Joined(parts, kept)
    is_plain = len(made.parts) == 1 and made.kept == list(range(made.parts[0].n_modes))
    return made.parts[0] if is_plain else made


class Joined(LinearBasis):
    """Bases one after another, and of their functions all or some.

    Parameters
    ----------
    parts : sequence of LinearBasis
        What is joined among them counts as its own parts; neighbours of which one basis has all functions are one.
    kept : iterable of int, optional
        Which functions of all parts, in the order of the coefficients; all by default.
    """

    title: ClassVar[str] = "joined"

    def __init__(self, parts: Sequence[LinearBasis], kept: Iterable[int] | None = None) -> None:
        self.parts: list[LinearBasis] = []
        self.kept: list[int]
        places: list[int] = []
        for part in parts:
            start = sum(one.n_modes for one in self.parts)
            places += [start + number for number in (part.kept if isinstance(part, Joined) else range(part.n_modes))]
            for one in part.parts if isinstance(part, Joined) else [part]:
                both = self.parts[-1].with_more(one) if self.parts else None
                self.parts = [*self.parts, one] if both is None else [*self.parts[:-1], both]
        self.kept = places if kept is None else [places[number] for number in kept]
        self.n_modes, self.n_columns = len(self.kept), sum(part.n_columns for part in self.parts)
        self.is_complex = any(part.is_complex for part in self.parts)
        self._columns = spans(part.n_columns for part in self.parts)
        self._functions = spans(part.n_modes for part in self.parts)

    @property
    def orders(self) -> IntArray:
        """Radial and azimuthal order of each function, (n_modes, 2)."""
        return np.concatenate([part.orders for part in self.parts])[self.kept]

    def columns(self, za: FloatArray, az: FloatArray, out: FloatArray | None = None) -> FloatArray:
        """Evaluate the columns of all parts, (n_columns, Npoints); see :meth:`LinearBasis.columns`."""
        if out is None:
            out = np.empty((self.n_columns, len(za)))
        for part, span in zip(self.parts, self._columns, strict=True):
            part.columns(za, az, out[span])
        return out

    def mix(self, rows: Array) -> Array:
        """Turn columns, (..., n_columns), into the functions that are kept, (..., n_modes)."""
        mixed = [part.mix(rows[..., span]) for part, span in zip(self.parts, self._columns, strict=True)]
        return np.concatenate(mixed, axis=-1)[..., self.kept]

    def column_coeffs(self, coeffs: Array) -> Array:
        """Return the equivalent coefficients of the columns, (..., n_columns)."""
        pairs = zip(self.parts, self._of_parts(coeffs), strict=True)
        return np.concatenate([part.column_coeffs(own) for part, own in pairs], axis=-1)

    def synthesize(self, coeffs: Array, za: FloatArray, az: FloatArray) -> Array:
        """Evaluate the beam, (Npoints,), each part in its own way."""
        pairs = zip(self.parts, self._of_parts(coeffs), strict=True)
        return np.asarray(sum(part.synthesize(own, za, az) for part, own in pairs))

    @property
    def table_nodes(self) -> tuple[int, int] | None:
        """As many as the part needs that needs most; none where one part has no table, or goes on otherwise."""
        needed = [nodes for part in self.parts if (nodes := part.table_nodes) is not None]
        if len(needed) < len(self.parts) or len({part.through_zenith for part in self.parts}) > 1:
            return None
        per_unit, n_az = zip(*needed, strict=True)
        return max(per_unit), max(n_az)

    @property
    def through_zenith(self) -> bool:
        """Whether those of all parts are."""
        return all(part.through_zenith for part in self.parts)

    def at_nodes(self, coeffs: Array, per_unit: int, n_az: int) -> FloatArray:
        """Evaluate the beam, the sum of all parts, at a table's nodes, (Nradii, Naz)."""
        pairs = zip(self.parts, self._of_parts(coeffs), strict=True)
        return np.asarray(sum(part.at_nodes(own, per_unit, n_az) for part, own in pairs))

    def _of_parts(self, coeffs: Array) -> list[Array]:
        """Give each part its coefficients, zero of what is not kept, (..., n_modes of the part)."""
        whole = np.zeros((*np.shape(coeffs)[:-1], sum(part.n_modes for part in self.parts)), np.asarray(coeffs).dtype)
        whole[..., self.kept] = coeffs
        return [whole[..., span] for span in self._functions]

    def describe(self) -> dict[str, Any]:
        """Return kind, the descriptions of the parts, and which of their functions are kept."""
        return {"kind": "joined", "parts": [part.describe() for part in self.parts], "kept": list(self.kept)}

    @classmethod
    def from_settings(cls, settings: Mapping[str, Any]) -> LinearBasis:
        """No job asks for one: effects of the model make it."""
        raise InputError("is no basis to begin with", field="[basis] kind", remedy="name one of its parts")

    @classmethod
    def from_description(cls, description: Mapping[str, Any]) -> Joined:
        """Restore it from a description in which the parts are restored already; ValueError where it is none."""
        basis = cls(description["parts"])
        kept = [int(number) for number in description["kept"]]
        if not kept or len(set(kept)) < len(kept) or not set(kept) <= set(range(basis.n_modes)):
            raise ValueError("functions that the parts do not have")
        return cls(basis.parts, kept)
