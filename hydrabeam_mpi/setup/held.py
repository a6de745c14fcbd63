"""Visibilities that one rank holds, in memory or out of files that are read whole or not at all, for all ranks.

Measurement sets and miriad files are read once, on rank 0. Every other rank gets from there the rows and channels that
it asks for, and keeps no more than these.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import count
from pathlib import Path
from typing import Any
from weakref import WeakValueDictionary

import numpy as np

from hydrabeam_mpi.data.observation import Array, FloatArray, IntArray
from hydrabeam_mpi.io.uvfile import UVHeader, UVRows, check_all_survive, file_kind
from hydrabeam_mpi.io.uvformat import READ_IN_PART
from hydrabeam_mpi.io.uvrows import SAMPLE_BYTES, WINDOW_BYTES, Samples
from hydrabeam_mpi.io.uvsource import KEPT_BYTES, Data, UVFile, UVInMemory
from hydrabeam_mpi.mpi import Comm, OneSided, bcast_object, together


class Held:
    """Visibilities that rank 0 holds, in the sense of `Source`, on any rank.

    As a pickle it stands for the one that the receiving rank has made together with the sender.
    """

    def __init__(self, comm: Comm, mine: UVInMemory | None) -> None:
        """Share what rank 0 has. Collective: all ranks of ``comm``."""
        self._mine = mine
        about = (mine.header, mine.rows, mine.file) if mine else None
        self._header, self._rows, self.file = bcast_object(comm, about)
        arrays = (mine.data, mine.flags, mine.nsamples) if mine else (None,) * 3
        self._arrays = [OneSided(comm, array) for array in arrays]
        self._key = next(_numbers)
        _held[self._key] = self

    def __str__(self) -> str:
        return str(self._header.path)

    def __reduce__(self) -> tuple[Any, ...]:
        """Name the one that all ranks have made."""
        return _found, (self._key,)

    def metadata(self) -> tuple[UVHeader, UVRows]:
        """Return the metadata, which all ranks have."""
        return self._header, self._rows

    def may_hold(self, times: FloatArray, freqs: FloatArray) -> bool:
        """Return True: all metadata are at hand; see `Source.may_hold`."""
        return True

    def samples(
        self, header: UVHeader, rows: IntArray, channels: IntArray, pols: IntArray, pol_convention: str | None
    ) -> Samples:
        """Get part of the data from the rank that holds them; see `Source.samples`."""
        if self._mine is not None:
            return self._mine.samples(header, rows, channels, pols, pol_convention)
        data, flags, nsamples = (_part(array, rows, channels, pols) for array in self._arrays)
        part = UVInMemory(header, self._rows, data, flags, nsamples)
        all_rows, all_channels, all_pols = map(np.arange, data.shape)
        return part.samples(header, all_rows, all_channels, all_pols, pol_convention)


_held: WeakValueDictionary[int, Held] = WeakValueDictionary()
_numbers = count()


def _found(key: int) -> Held:
    return _held[key]


def _part(array: OneSided, rows: IntArray, channels: IntArray, pols: IntArray) -> Array:
    """Get part of an array, (len(rows), len(channels), len(pols)), some rows at once."""
    between = slice(int(channels.min()), int(channels.max()) + 1)
    n_parts = 1 + len(rows) * (between.stop - between.start) * array.shape[2] * SAMPLE_BYTES // WINDOW_BYTES
    parts = (array.get(some, between) for some in np.array_split(rows, n_parts))
    return np.concatenate([part[np.ix_(np.arange(len(part)), channels - between.start, pols)] for part in parts])


def _opened(data: Data, whole: bool, room: int) -> Data:
    if not isinstance(data, Path):
        return data
    return UVInMemory.read(data) if whole else UVFile(data, room)


def hold(world: Comm, files: Sequence[Data]) -> tuple[Data, ...]:
    """Return files and what is in memory such that every rank can read of them what it needs.

    Files that are read in part stay where they are; of their metadata each rank keeps those that it has read, as far as
    there is room. Others are read here, on rank 0, and held there, as is what is in memory already.

    Collective: all ranks of `world`; the files of rank 0 count.

    Raises
    ------
    InputError
        On all ranks, if a file that is read here cannot be used.
    """
    opened: list[Data] = []
    with together(world):
        if world.rank == 0:
            whole = [one for one in files if isinstance(one, Path) and file_kind(one) not in READ_IN_PART]
            check_all_survive(whole)
            opened = [_opened(one, one in whole, KEPT_BYTES // len(files)) for one in files]
    if world.size == 1:
        return tuple(opened)
    in_memory = [one if isinstance(one, UVInMemory) else None for one in opened]
    left: list[Data | None] = bcast_object(world, [None if isinstance(one, UVInMemory) else one for one in opened])
    pairs = zip(left, in_memory or [None] * len(left), strict=True)
    return tuple(Held(world, mine) if one is None else one for one, mine in pairs)
