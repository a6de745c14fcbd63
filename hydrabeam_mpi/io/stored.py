"""Arrays that wait in files until they are written elsewhere, so that they are never all in memory."""

from __future__ import annotations

import shutil
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

from hydrabeam_mpi.data.observation import Array

FOLDER = ".waiting"


class Stored:
    """An array in a file; numpy and h5py take it for the array itself, which they read each time.

    Parameters
    ----------
    path : Path
        Written anew.
    array : ndarray
    """

    def __init__(self, path: Path, array: Array) -> None:
        path.parent.mkdir(exist_ok=True)
        np.save(path, array)
        self.path, self.shape, self.dtype = path, array.shape, array.dtype

    def __array__(self, dtype: DTypeLike = None, copy: bool | None = None) -> Array:
        """Read it."""
        return np.asarray(np.load(self.path), dtype=dtype)


def store(folder: Path | None, arrays: dict[str, Any], name: str, number: int) -> None:
    """Put one of the ``arrays`` into a file of a ``folder``, if there is one, and room; else it stays in memory.

    The file is called by the name and a ``number``.
    """
    if folder is not None:
        with suppress(OSError):
            arrays[name] = Stored(folder / FOLDER / f"{name}_{number:04d}.npy", arrays[name])


def drop_stored(folder: Path) -> None:
    """Remove what has waited in a folder."""
    shutil.rmtree(folder / FOLDER, ignore_errors=True)
