"""Writing one chain: draws are collected for some seconds, written as a segment, and segments are put together."""

from __future__ import annotations

import fcntl
import logging
import os
import time
from collections.abc import Mapping, Sequence
from itertools import accumulate, takewhile
from pathlib import Path
from typing import Any

import numpy as np

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.disk import writing
from hydrabeam_mpi.io.finite import check_finite
from hydrabeam_mpi.sampling.storage.chain_files import ASIDE, ChainFiles
from hydrabeam_mpi.sampling.storage.segment import Content, Segment, joined, read_segment, write_segment
from hydrabeam_mpi.sampling.storage.variable import Variable
from hydrabeam_mpi.sampling.storage.whole_file import sync_folder

logger = logging.getLogger(__name__)

FLUSH_S = 5.0
"""Draws are written once they are so old, which is all that a kill can cost; slower draws each by itself."""
PAUSE = 200.0
"""And the time since the last writing is so many times what that took: half a percent of a run, on slow disks, too."""
BUFFER_BYTES = 8 << 20
"""Draws of so many bytes are written at once, as they have to be kept in memory."""
SMALL_DRAWS = 1000
SMALL_BYTES = 8 << 20
"""Segments with fewer draws and fewer bytes than these are small, ..."""
MOST_SMALL = 32
"""... and so many of them are put together, up to twice `SMALL_BYTES`: 100,000 draws make some hundred files."""
LOCK = ".lock"
REMEDY = "leave out that draw's cause: look at the widths of the priors and at the weights of the data"


class ChainWriter:
    """Appends draws to one chain. Only one process may, at a time.

    Parameters
    ----------
    files : ChainFiles
    variables : sequence of Variable

    Attributes
    ----------
    n_draws : int
        Draws so far, written or not.
    seconds : float
        Spent on writing.

    Raises
    ------
    InputError
        If another process writes the chain, or the folder cannot be written.
    """

    def __init__(self, files: ChainFiles, variables: Sequence[Variable]) -> None:
        self._files, self._variables = files, tuple(variables)
        self.seconds = 0.0
        self._rows: list[Content] = []
        self._buffered = 0
        with writing(files.folder):
            try:
                files.folder.mkdir(parents=True, exist_ok=True)
            except FileExistsError as error:
                raise InputError("is no folder", file=files.folder, field="-o", remedy="remove it") from error
            self._lock: int | None = _claimed(files.folder)
            if caution := files.caution():
                logger.warning("%s; what is damaged, and what came after it, is in %s", caution, ASIDE)
            self._segments = files.tidy(self._variables)
            self._merge()  # as a kill may have come between the writing of a segment and this
        self.n_draws = self._segments[-1].end if self._segments else 0
        self._last = time.monotonic()
        self._took = 0.0

    def __enter__(self) -> ChainWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def append(self, draw: Mapping[str, Any], state: Mapping[str, Any], info: Mapping[str, float]) -> None:
        """Add a draw.

        Parameters
        ----------
        draw : mapping
            The value of every variable.
        state : mapping
            Arrays from which the chain goes on after this draw.
        info : mapping
            Numbers about the draw, ``seconds`` among them; of every draw the same.

        Raises
        ------
        InputError
            If a number is not finite, or the disk takes no more.
        """
        check_finite(f"chain {self._files.chain}, draw {self.n_draws}", draw, REMEDY)
        row = Content(
            {variable.name: variable.row(draw[variable.name]) for variable in self._variables},
            {name: np.array([value], dtype=float) for name, value in ({"time": time.time()} | dict(info)).items()},
            {name: np.array(value)[np.newaxis] for name, value in state.items()},
        )
        self._rows.append(row)
        self._buffered += sum(values.nbytes for values in row.arrays.values())
        self.n_draws += 1
        waited = time.monotonic() - self._last
        if self._buffered > BUFFER_BYTES or waited > max(FLUSH_S, PAUSE * self._took):
            self.flush()

    def flush(self) -> None:
        """Write what has been collected.

        Raises
        ------
        InputError
            If the disk takes no more; says how many draws are kept.
        """
        if not self._rows:
            return
        began = time.monotonic()
        content = joined(self._rows)
        first = self.n_draws - len(self._rows)
        folder, chain = self._files.folder, self._files.chain
        try:
            with writing(folder):
                self._segments.append(write_segment(folder, chain, first, content, self._variables))
        except InputError as error:
            message = f"{error.message}: the first {first} draws of chain {chain} are kept"
            remedy = "make room, and run the same command again to go on"
            raise InputError(message, file=folder.parent, field="-o", remedy=remedy) from error
        self._rows, self._buffered = [], 0
        self._merge()
        self._last = time.monotonic()
        self._took = self._last - began
        self.seconds += self._took

    def close(self) -> None:
        """Write what has been collected, and let others write the chain."""
        if self._lock is not None:
            try:
                self.flush()
            finally:
                os.close(self._lock)
                self._lock = None

    def _merge(self) -> None:
        """Put the oldest of many small segments together; they stay until their draws are on the disk elsewhere."""
        small = list(takewhile(_is_small, reversed(self._segments)))[::-1]
        if len(small) < MOST_SMALL:
            return
        parts = _up_to(small, 2 * SMALL_BYTES)
        content = joined([read_segment(part) for part in parts])
        try:
            merged = write_segment(self._files.folder, self._files.chain, parts[0].first, content, self._variables)
        except OSError:
            return  # no room for both; the draws are where they were
        begin = len(self._segments) - len(small)
        self._segments[begin : begin + len(parts)] = [merged]
        for part in parts:
            part.path.unlink()
        sync_folder(self._files.folder)


def _is_small(segment: Segment) -> bool:
    return segment.n_draws < SMALL_DRAWS and segment.path.stat().st_size < SMALL_BYTES


def _up_to(small: Sequence[Segment], n_bytes: int) -> Sequence[Segment]:
    """Return the first segments that have no more bytes together."""
    sizes = accumulate(one.path.stat().st_size for one in small)
    return small[: sum(size <= n_bytes for size in sizes)]


def _claimed(folder: Path) -> int:
    """Keep others from writing a chain as long as this process lives, or closes what is returned."""
    lock = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o666)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        os.close(lock)
        remedy = "wait until it has ended, or end it"
        raise InputError("is being written by another run", file=folder, remedy=remedy) from error
    except OSError:
        pass  # a file system without locks
    return lock
