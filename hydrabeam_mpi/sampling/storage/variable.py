"""What a chain draws: its variables, with their axes, units and names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from hydrabeam_mpi.data.observation import Array


@dataclass(frozen=True)
class Variable:
    """One of the arrays of which every draw has a value.

    Attributes
    ----------
    name : str
        As in the files; letters, digits and "_".
    block : str
        What is drawn together with it: "beam", an effect, the noise.
    shape : tuple of int
        Of its value in one draw; empty for a number.
    dims : tuple of str
        Name of each axis.
    coords : mapping
        Labels along an axis, by its name; an axis without is numbered.
    unit, long_name : str
    dtype : str
        "float64" or "complex128".
    """

    name: str
    block: str
    shape: tuple[int, ...] = ()
    dims: tuple[str, ...] = ()
    coords: Mapping[str, Sequence[Any]] = field(default_factory=dict)
    unit: str = ""
    long_name: str = ""
    dtype: str = "float64"

    def __post_init__(self) -> None:
        assert self.name.isidentifier(), self.name
        assert len(self.dims) == len(self.shape), self.name
        assert self.dtype in ("float64", "complex128"), self.name
        lengths = dict(zip(self.dims, self.shape, strict=True))
        assert all(len(labels) == lengths[dim] for dim, labels in self.coords.items()), self.name

    @property
    def size(self) -> int:
        """Numbers in one draw."""
        return int(np.prod(self.shape, dtype=int))

    def row(self, value: Any) -> Array:
        """Return a copy of the value of one draw as the files have it, (1, size).

        Raises
        ------
        ValueError
            If it has another shape.
        """
        found = np.array(value, dtype=self.dtype)
        if found.shape != self.shape:
            raise ValueError(f"{self.name} has shape {found.shape}, and not {self.shape}")
        return found.reshape(1, -1)

    def label(self, index: int) -> str:
        """Name the number at a place of the flattened array: "flux[Fornax A]", "beam[freq=1.2e+08, mode=3]".

        Axes of length one say nothing, and labels that are words need no name before them.
        """
        place = (int(at) for at in np.unravel_index(index, self.shape))
        told = [
            _written(dim, self.coords[dim][at] if dim in self.coords else at)
            for dim, at, length in zip(self.dims, place, self.shape, strict=True)
            if length > 1
        ]
        return f"{self.name}[{', '.join(told)}]" if told else self.name

    def to_table(self) -> dict[str, Any]:
        """Describe it in JSON."""
        return asdict(self) | {"coords": {dim: [_plain(one) for one in at] for dim, at in self.coords.items()}}

    @classmethod
    def from_table(cls, table: Mapping[str, Any]) -> Variable:
        """Read what `to_table` wrote."""
        return cls(**{**table, "shape": tuple(table["shape"]), "dims": tuple(table["dims"])})


def _written(dim: str, label: Any) -> str:
    """Write a label, a number with the name of its axis."""
    return label if isinstance(label, str) else f"{dim}={label:.10g}"


def _plain(label: Any) -> Any:
    """Return a label as JSON knows it."""
    return label.item() if isinstance(label, np.generic) else label
