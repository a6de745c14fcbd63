"""Segments: files with some draws of a chain, one after the other, and the chain's state after each of them.

Layout
------
Root attributes ``format``, ``chain``, ``first_draw`` and ``n_draws``; the groups

=====  ==============================================================================================
draws  of every variable (n_draws, size), its axes flattened; attributes ``units``, ``long_name``, ``block``,
       ``dims``, ``shape``
info   numbers about every draw, (n_draws,): ``seconds``, ``time`` (s since 1970) and what the chain adds
state  what the chain goes on from after each draw, (n_draws, ...); what is in ``draws`` already is not stored twice:
       an attribute says under which name it is there
=====  ==============================================================================================

and ``checksums``, (n_draws,): the CRC-32 of all that there is of a draw. The last 32 bytes of the file are the SHA-256
of those before them. What describes the data comes first in the file, and a few draws follow on the others in all data
sets at a time, so that what remains of a truncated file has the draws before the cut.
"""

from __future__ import annotations

import io
import json
import re
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import h5py
import numpy as np

from hydrabeam_mpi.data.observation import Array
from hydrabeam_mpi.io.formats import describe, write_text
from hydrabeam_mpi.memory import free_bytes
from hydrabeam_mpi.sampling.storage.variable import Variable
from hydrabeam_mpi.sampling.storage.whole_file import write_hdf5

FORMAT = 1
PIECES = 16
"""So many times the draws of a segment follow on each other in all of its data sets."""
CHUNK_BYTES = 1 << 14
"""A piece that HDF5 reads at once: small beside a segment, so that one parameter is read without the others."""
NAME = re.compile(r"(\d{8,})-(\d{8,})\.h5")
GROUPS = ("draws", "info", "state")
END_OF_FILE = slice(28, 36)
"""Where HDF5 writes the length of a file that it has made."""
ASSUMED_BYTES = 1 << 32
"""Bytes of memory to go by where the system does not tell."""
PADDING = b"\xa5"
"""Stands for what is missing of a file; no draw of it has its checksum."""


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
        After each draw, (n_draws, ...).
    """

    draws: Mapping[str, Array]
    info: Mapping[str, Array]
    state: Mapping[str, Array]

    @property
    def n_draws(self) -> int:
        """How many there are."""
        return len(self.info["time"])

    @property
    def arrays(self) -> dict[str, Array]:
        """All of them by group and name."""
        return {f"{group}/{name}": values for group in GROUPS for name, values in getattr(self, group).items()}

    def checksums(self) -> Array:
        """Return the checksum of each draw, (n_draws,)."""
        arrays = [np.ascontiguousarray(values) for _, values in sorted(self.arrays.items())]
        found = np.zeros(self.n_draws, dtype=np.uint32)
        for number in range(self.n_draws):
            crc = 0
            for values in arrays:
                crc = zlib.crc32(values[number].tobytes(), crc)
            found[number] = crc
        return found

    def first(self, n: int) -> Content:
        """Return the first n draws."""
        return Content(*({name: values[:n] for name, values in getattr(self, group).items()} for group in GROUPS))


@dataclass(frozen=True)
class Segment:
    """A segment's file.

    Attributes
    ----------
    path : Path
    first, end : int
        Its first draw, and the one after its last.
    image : bytes, optional
        In place of the file where that is damaged: what remains of it, from the first draw to before ``end``.
    """

    path: Path
    first: int
    end: int
    image: bytes | None = field(default=None, repr=False)

    @property
    def n_draws(self) -> int:
        """How many draws it has."""
        return self.end - self.first

    def open(self) -> h5py.File:
        """Open it for reading.

        Raises
        ------
        OSError
            If it cannot be read.
        """
        return h5py.File(self.path if self.image is None else io.BytesIO(self.image), "r")

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
    again = _in_draws(content)
    arrays = {name: values for name, values in content.arrays.items() if name.removeprefix("state/") not in again}
    arrays["checksums"] = content.checksums()

    def fill(file: h5py.File) -> None:
        file.attrs.update(format=FORMAT, chain=chain, first_draw=first, n_draws=n)
        for group in GROUPS:
            file.create_group(group)
        for name, told in again.items():
            write_text(file["state"], name, json.dumps(told))
        sets = {
            name: file.create_dataset(name, values.shape, values.dtype, chunks=_chunks(values))
            for name, values in arrays.items()
        }
        for variable in variables:
            data = sets[f"draws/{variable.name}"]
            describe(data, variable.unit, variable.long_name)
            write_text(data, "block", variable.block)
            write_text(data, "dims", " ".join(variable.dims))
            data.attrs["shape"] = np.array(variable.shape, dtype=int)
        for begin in range(0, n, _draws_a_piece(n)):
            piece = slice(begin, begin + _draws_a_piece(n))
            for name, values in arrays.items():
                sets[name][piece] = values[piece]

    write_hdf5(segment.path, fill)
    return segment


def read_segment(segment: Segment) -> Content:
    """Read all of a segment.

    Raises
    ------
    OSError
        If it cannot be read.
    """
    return _read(segment, slice(0, segment.n_draws))


def last_state(segment: Segment) -> dict[str, Array]:
    """Read the chain's state after the last draw of a segment.

    Raises
    ------
    OSError
        If it cannot be read.
    """
    content = _read(segment, slice(segment.n_draws - 1, segment.n_draws))
    return {name: values[0] for name, values in content.state.items()}


def remains_of(segment: Segment) -> Segment | None:
    """Find the draws before the damage in a damaged file; None where there are none.

    Raises
    ------
    OSError
        If it cannot be read at all.
    """
    image = segment.path.read_bytes()
    length = int.from_bytes(image[END_OF_FILE], "little")
    if length > (free_bytes() or ASSUMED_BYTES) // 4:
        return None  # it is this number that is damaged
    image += PADDING * (length - len(image))
    told = Segment(segment.path, segment.first, segment.end, image)
    try:
        with told.open() as file:
            stored = file["checksums"][()]
        right = stored == read_segment(told).checksums()
    except Exception:  # HDF5 and what reads with it raise whatever occurs to them
        return None
    n = len(right) if right.all() else int(np.argmin(right))
    return Segment(segment.path, segment.first, segment.first + n, image) if n else None


def joined(parts: Sequence[Content]) -> Content:
    """Put draws that follow on each other into one."""
    return Content(
        *(
            {name: np.concatenate([getattr(part, group)[name] for part in parts]) for name in getattr(parts[0], group)}
            for group in GROUPS
        )
    )


def _read(segment: Segment, draws: slice) -> Content:
    with segment.open() as file:
        groups = {group: {name: data[draws] for name, data in file[group].items()} for group in GROUPS}
        for name, told in file["state"].attrs.items():
            variable, shape = json.loads(told)
            groups["state"][name] = groups["draws"][variable].reshape(-1, *shape)
    return Content(**groups)


def _in_draws(content: Content) -> dict[str, tuple[str, tuple[int, ...]]]:
    """Find states that are draws: their names, with that of the variable and their shapes."""
    return {
        name: (variable, values.shape[1:])
        for name, values in content.state.items()
        for variable, drawn in content.draws.items()
        if drawn.dtype == values.dtype and np.array_equal(drawn, values.reshape(len(values), -1))
    }


def _draws_a_piece(n_draws: int) -> int:
    return -(-n_draws // PIECES)


def _chunks(values: Array) -> tuple[int, ...] | None:
    """Return how HDF5 cuts up an array, (n_draws, ...): some draws of few numbers."""
    if not values.size:
        return None
    draws = _draws_a_piece(len(values))
    shape = list(values.shape[1:])
    for axis, length in enumerate(shape):
        inner = int(np.prod(shape[axis + 1 :], dtype=int))
        shape[axis] = max(1, min(length, CHUNK_BYTES // (draws * values.itemsize * inner)))
    return draws, *shape
