"""Antenna layouts for simulations: the hexagon of HDBI II, or positions from a file."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
from pyuvdata import UVData
from scipy.spatial import cKDTree

from hydrabeam_mpi.data.limits import EARTH_DIAMETER
from hydrabeam_mpi.data.observation import FloatArray, IntArray
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.reading import check_file, reading

FORMATS = "give columns 'E N U' in metres with or without a header, which may also name 'number' and 'name'"
# Metres within which two antennas are one: the resolution of positions relative to the centre of the Earth.
SAME_PLACE = 1e-8


@dataclass(frozen=True, eq=False)
class Layout:
    """Where the antennas stand.

    Attributes
    ----------
    numbers : ndarray of int, (Nants,)
    names : tuple of str
    antpos : ndarray, (Nants, 3)
        East, north, up in metres.
    """

    numbers: IntArray
    names: tuple[str, ...]
    antpos: FloatArray


def hexagon(side: int, diagonal: int, spacing: float) -> Layout:
    """Lay out a close-packed hexagon in rows from west to east, the southernmost first.

    Parameters
    ----------
    side, diagonal : int
        Antennas in the shortest (first and last) and in the longest (middle) row; regular if
        ``diagonal = 2 side - 1``, as the 37 antennas of (4, 7).
    spacing : float
        Metres between neighbours.

    Raises
    ------
    InputError
        If ``diagonal`` is shorter than ``side``.
    """
    if not 1 <= side <= diagonal:
        raise InputError(
            f"a hexagon of {side} antennas a side and {diagonal} on its diagonal does not exist",
            field="hex",
            remedy="give [side, diagonal], such as [4, 7]",
        )
    lengths = [*range(side, diagonal), *range(diagonal, side - 1, -1)]
    antpos = np.array(
        [
            (column - (length - 1) / 2, (row - (len(lengths) - 1) / 2) * np.sqrt(3) / 2, 0.0)
            for row, length in enumerate(lengths)
            for column in range(length)
        ]
    )
    return _layout(np.arange(len(antpos)), None, spacing * antpos)


def read_layout(path: Path) -> Layout:
    """Read antenna positions from a uvh5 file (the antennas with data) or from text or CSV.

    Raises
    ------
    InputError
        If the file is missing or unreadable, an antenna has no position, one that is not on Earth, or a number
        twice, or two stand in one place.
    """
    check_file(path, field="[data.simulate.array] file")
    layout = _read_uvh5(path) if h5py.is_hdf5(path) else _read_text(path)
    without = layout.numbers[~np.isfinite(layout.antpos).all(axis=1)]
    if len(without):
        raise InputError(f"antenna {without[0]} has no position", file=path, remedy=FORMATS)
    far = np.abs(layout.antpos).max(axis=1)
    if far.max() > EARTH_DIAMETER:
        told = f"antenna {layout.numbers[far.argmax()]} stands {far.max():.3g} m from the middle of the array"
        raise InputError(told, file=path, remedy="give places on Earth, in metres")
    if len(np.unique(layout.numbers)) < len(layout.numbers):
        raise InputError("an antenna number stands twice", file=path, field="number", remedy="number them apart")
    together = cKDTree(layout.antpos).query_pairs(SAME_PLACE)
    if together:
        one, other = (layout.numbers[antenna] for antenna in min(together))
        raise InputError(f"antennas {one} and {other} stand in one place", file=path, remedy="give each its own")
    return layout


def _layout(numbers: IntArray, names: tuple[str, ...] | None, antpos: FloatArray) -> Layout:
    return Layout(numbers, names or tuple(f"ANT{number}" for number in numbers), antpos)


def _read_uvh5(path: Path) -> Layout:
    with reading(path, "uvh5"):
        uvd = UVData.from_file(path, file_type="uvh5", read_data=False)
        antpos, numbers = uvd.get_enu_data_ants()
        names = dict(zip(uvd.telescope.antenna_numbers, uvd.telescope.antenna_names, strict=True))
    return _layout(np.asarray(numbers, dtype=np.int64), tuple(str(names[number]) for number in numbers), antpos)


def _read_text(path: Path) -> Layout:
    """Read rows of text; the header, if there is one, has no number in it."""
    with reading(path, "text or uvh5", remedy=FORMATS):
        lines = path.read_text().splitlines()
    rows = [re.split(r"[,\s]+", line.strip()) for line in lines if line.strip() and not line.startswith("#")]
    header = ["e", "n", "u"]
    if rows and not any(_is_number(cell) for cell in rows[0]):
        header = [cell.lower() for cell in rows.pop(0)]
    for column in "enu":
        if column not in header:
            raise InputError("the header lacks this column", file=path, field=column.upper(), remedy=FORMATS)
    if not rows:
        raise InputError("no antennas", file=path, remedy=FORMATS)
    for row in rows:
        if len(row) != len(header):
            raise InputError(f"{len(row)} columns, not {len(header)}: {' '.join(row)}", file=path, remedy=FORMATS)
    columns = {name: [row[i] for row in rows] for i, name in enumerate(header)}
    try:
        antpos = np.array([columns[column] for column in "enu"], dtype=float).T
        numbers = np.array(columns.get("number", range(len(rows))), dtype=np.int64)
    except ValueError as error:
        raise InputError(f"not a number ({error})", file=path, remedy=FORMATS) from error
    return _layout(numbers, tuple(columns.get("name", ())), antpos)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
