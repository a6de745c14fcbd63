"""Segments: files with some draws of a chain, one after the other, and the chain's state after the last of them.

Layout
------
Root attributes ``format``, ``chain``, ``first_draw`` and ``n_draws``; the groups

=====  ==============================================================================================
draws  of every variable (n_draws, size), its axes flattened; attributes ``units``, ``long_name``, ``block``,
       ``dims``, ``shape``
info   numbers about every draw, (n_draws,): ``seconds``, ``time`` (s since 1970) and what the chain adds
state  what the chain goes on from after the last draw of the segment
=====  ==============================================================================================

The last 32 bytes of the file are the SHA-256 of those before them.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from hydrabeam_mpi.data.observation import Array
from hydrabeam_mpi.sample.storage.variable import Variable
from hydrabeam_mpi.sample.storage.whole_file import write_hdf5

FORMAT = 1
CHUNK_DRAWS = 256
CHUNK_BYTES = 1 << 16
"""A piece that HDF5 reads at once: small beside a segment, so that one parameter is read without the others."""
NAME = re.compile(r"(\d{8,})-(\d{8,})\.h5")


@dataclass(frozen=True)
class Content:
    """Draws of a segment.

    Attributes
    ----------
    draws : mapping
        By variable, (n_draws, size).
    info : mapping
        By name, (n_draws,).
    state : mapping
        After the last draw.
    """

    draws: Mapping[str, Array]
    info: Mapping[str, Array]
    state: Mapping[str, Array]

    @property
    def n_draws(self) -> int:
        """How many there are."""
        return len(self.info["time"])


@dataclass(frozen=True)
class Segment:
    """A segment's file.

    Attributes
    ----------
    path : Path
    first, end : int
        Its first draw, and the one after its last.
    """

    path: Path
    first: int
    end: int

    @property
    def n_draws(self) -> int:
        """How many draws it has."""
        return self.end - self.first

    @classmethod
    def named(cls, path: Path) -> Segment | None:
        """Read the name of a file; None for other files."""
        found = NAME.fullmatch(path.name)
        return cls(path, int(found[1]), int(found[2]) + 1) if found else None


def write_segment(folder: Path, chain: int, first: int, content: Content, variables: Sequence[Variable]) -> Segment:
    """Write a segment whole.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    n = content.n_draws
    segment = Segment(folder / f"{first:08d}-{first + n - 1:08d}.h5", first, first + n)

    def fill(file: h5py.File) -> None:
        file.attrs.update(format=FORMAT, chain=chain, first_draw=first, n_draws=n)
        for variable in variables:
            data = file.create_dataset(
                f"draws/{variable.name}", data=content.draws[variable.name], chunks=_chunks(n, variable)
            )
            data.attrs.update(units=variable.unit, long_name=variable.long_name, block=variable.block)
            data.attrs.update(dims=list(variable.dims) or [""], shape=np.array(variable.shape, dtype=int))
        for group, arrays in (("info", content.info), ("state", content.state)):
            file.create_group(group)
            for name, values in arrays.items():
                file[group][name] = values

    write_hdf5(segment.path, fill)
    return segment


def read_segment(segment: Segment) -> Content:
    """Read all of a segment.

    Raises
    ------
    OSError
        If it cannot be read.
    """
    with h5py.File(segment.path, "r") as file:
        groups = {group: {name: data[()] for name, data in file[group].items()} for group in ("draws", "info", "state")}
    return Content(**groups)


def joined(parts: Sequence[Content]) -> Content:
    """Put draws that follow on each other into one."""
    return Content(
        {name: np.concatenate([part.draws[name] for part in parts]) for name in parts[0].draws},
        {name: np.concatenate([part.info[name] for part in parts]) for name in parts[0].info},
        parts[-1].state,
    )


def _chunks(n_draws: int, variable: Variable) -> tuple[int, int] | None:
    """Return how HDF5 cuts up a variable: many draws of few parameters."""
    if not variable.size:
        return None
    draws = min(n_draws, CHUNK_DRAWS)
    columns = CHUNK_BYTES // (draws * np.dtype(variable.dtype).itemsize)
    return draws, max(1, min(variable.size, columns))
