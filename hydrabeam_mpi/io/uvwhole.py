"""Whether a file of visibilities is whole, found out before it is read."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.reading import DAMAGED, reading

_SAMPLES = {"Data/visdata": "complex numbers", "Data/flags": "true or false", "Data/nsamples": "real numbers"}

# What the library says before it ends the process.
_LAST_WORDS = "### Fatal Error:"
# Reads files one after another, and says of which before it does.
_READ = """
import sys, warnings
warnings.simplefilter("ignore")
from pyuvdata import UVData
for path in sys.argv[2:]:
    print(path, flush=True)
    try:
        UVData().read(path, file_type=sys.argv[1], run_check=False, background_lsts=False, ignore_single_chan=False)
    except Exception as error:
        sys.exit(f"### Fatal Error: {error}")
"""

# Folders that could be read, as they were: to find it out anew takes a process of seconds each time.
_survived: set[tuple[tuple[str, int, int], ...]] = set()


def check_uvh5(path: Path) -> None:
    """Make sure that an HDF5 file is whole and holds visibilities, flags and nsamples.

    Raises
    ------
    InputError
        If it is damaged, something else, or its samples are of other types.
    """
    with reading(path, "uvh5"), h5py.File(path, "r") as file:
        missing = next((name for name in ("Header/time_array", *_SAMPLES) if name not in file), None)
        if missing:
            raise InputError("not a uvh5 file, although HDF5", field=missing, remedy="give a uvh5 file")
        for name, wanted in _SAMPLES.items():
            if not _holds(file[name].dtype, wanted):
                told = f"holds values of type {file[name].dtype}, not {wanted}"
                raise InputError(told, field=name, remedy="write it again with pyuvdata")


def _holds(dtype: np.dtype[Any], wanted: str) -> bool:
    """Tell whether a type is one for complex numbers (also of integers, as a pair), flags or real numbers."""
    if wanted == "complex numbers":
        return dtype.kind == "c" or dtype.names == ("r", "i")
    return dtype.kind in ("b" if wanted == "true or false" else "iuf")


def check_survives(paths: Sequence[Path], kind: str) -> None:
    """Make sure that miriad files or measurement sets can be read, in a process of its own.

    The libraries of both may end the process in which they meet a damaged file, and speak past Python. What could be
    read once, and has not changed, is not tried again.

    Parameters
    ----------
    paths : sequence of Path
        Of that kind.
    kind : {"miriad", "ms"}

    Raises
    ------
    InputError
        If it does.
    """
    if kind == "ms" and find_spec("casacore") is None:
        return  # the reader says so
    states = {path: _state(path) for path in paths}
    paths = [path for path in paths if states[path] not in _survived]
    if not paths:
        return
    command = [sys.executable, "-c", _READ, kind, *map(str, paths)]
    done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
    if done.returncode:
        begun = done.stdout.splitlines()
        said = [line.split(":", 1)[1].strip(" .") for line in done.stderr.splitlines() if line.startswith(_LAST_WORDS)]
        reason = f" ({said[-1]})" if said else ""
        raise InputError(f"cannot be read as {kind}{reason}", file=begun[-1] if begun else paths[0], remedy=DAMAGED)
    _survived.update(states[path] for path in paths)


def _state(path: Path) -> tuple[tuple[str, int, int], ...]:
    """Tell what a folder is and has in it: names, sizes and times of the last change; links are not followed."""
    states = ((str(file), file.lstat()) for file in [path, *sorted(path.rglob("*"))])
    return tuple((name, state.st_size, state.st_mtime_ns) for name, state in states)
