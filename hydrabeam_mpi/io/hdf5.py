"""HDF5 files on disks that may be full."""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py


class HDF5Target(io.FileIO):
    """File for HDF5 to write through, which never fails before `settle` is called.

    HDF5 itself cannot end well once a write has failed: it tries again whenever an object is closed, says so each time,
    and breaks off the process at its exit. So it is told that all went well.

    Parameters
    ----------
    path : Path
        Replaced if it exists.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path, "w+")
        self._error: OSError | None = None

    def write(self, content: Any) -> int:
        """Write all of ``content``, or nothing more once a write has failed."""
        view = memoryview(content).cast("B")
        done = 0
        try:
            while self._error is None and done < len(view):
                done += super().write(view[done:])
        except OSError as error:
            self._error = error
        return len(view)

    def truncate(self, size: int | None = None) -> int:
        """Set the length of the file."""
        try:
            return super().truncate(size)
        except OSError as error:
            self._error = self._error or error
            return self.tell() if size is None else size

    def settle(self) -> None:
        """Make sure that all that was written is on the disk.

        Raises
        ------
        OSError
            What the first write that failed said.
        """
        if self._error is None:
            os.fsync(self.fileno())
        else:
            raise self._error


@contextmanager
def new_hdf5(path: Path) -> Iterator[h5py.File]:
    """Open an HDF5 file to be written from the beginning.

    Raises
    ------
    OSError
        At the end, if not all of it could be written.
    """
    with HDF5Target(path) as target:
        try:
            with h5py.File(target, "w") as file:
                yield file
        finally:
            target.settle()
