"""Versions of the layouts of files, and what their data sets say of themselves."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.reading import read_json

FORMAT = "format"
"""Name of the attribute, or of the key of JSON, with the version: a whole number."""
LOOP_FORMAT = 1
"""Of ``loop.json``; ``tables/loop.schema.json`` describes it."""


def check_format(stored: Any, newest: int) -> None:
    """Make sure that this version reads a layout.

    Parameters
    ----------
    stored
        What a file says; None, as in files of before there was a version, stands for the first layout.
    newest : int
        The version that is written now; those before it are read.

    Raises
    ------
    InputError
        If it is another one.
    """
    is_number = isinstance(stored, int | np.integer) and not isinstance(stored, bool)
    if stored is not None and not (is_number and 1 <= stored <= newest):
        told = f"is of format {stored!s:.40}, and this version of the program reads 1 to {newest}"
        raise InputError(told, field=FORMAT, remedy="read it with the version that wrote it")


def read_loop(path: Path, remedy: str) -> dict[str, Any]:
    """Read ``loop.json``.

    Raises
    ------
    InputError
        If it cannot be read, or is of a layout that is not known.
    """
    record = read_json(path, what="what a loop found", remedy=remedy)
    try:
        check_format(record.get(FORMAT), LOOP_FORMAT)
    except InputError as error:
        error.locate(path)
        raise
    return record


def write_text(place: h5py.Group | h5py.Dataset, name: str, text: str) -> None:
    """Write an attribute as text of fixed length: HDF5 keeps other text without a checksum, and may hang in it."""
    content = text.encode() or b" "
    place.attrs.create(name, content, dtype=h5py.string_dtype("utf-8", len(content)))


def describe(data: h5py.Dataset, units: str, long_name: str) -> None:
    """Write what a data set holds: the unit, "1" of a pure number, and a name in words."""
    write_text(data, "units", units)
    write_text(data, "long_name", long_name)
