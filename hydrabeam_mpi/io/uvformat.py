"""The formats of visibilities by the names that pyuvdata has for them; a new one has its line in `FORMATS`."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.io.reading import reading
from hydrabeam_mpi.io.uvwhole import check_uvh5


@dataclass(frozen=True)
class Format:
    """How a format is told from others and read.

    Attributes
    ----------
    called : str
        With its article, for sentences.
    is_of : callable
        Tells by what a file or a folder holds whether it is of this format.
    in_part : bool
        Whether pyuvdata reads it in part rather than whole.
    sample_by_sample : bool
        Whether it does so along all axes at once (``multidim_index``).
    is_talkative : bool
        Whether the library beneath prints what it thinks.
    needs : (str, str), optional
        Module that reads it, which may be missing, and the package that has this.
    check : callable, optional
        Makes sure that a file is whole.
    axes : callable, optional
        Reads the times of all rows (JD), (Nblts,), and the frequencies (Hz), (Nfreqs,), without any other metadata.
    """

    called: str
    is_of: Callable[[Path], bool]
    in_part: bool = False
    sample_by_sample: bool = False
    is_talkative: bool = False
    needs: tuple[str, str] | None = None
    check: Callable[[Path], None] | None = None
    axes: Callable[[Path], tuple[FloatArray, FloatArray]] | None = None


def _begins_with(magic: bytes) -> Callable[[Path], bool]:
    def begins(path: Path) -> bool:
        if os.path.isdir(path):
            return False
        with path.open("rb") as file:
            return file.read(len(magic)) == magic

    return begins


def _has(member: str) -> Callable[[Path], bool]:
    return lambda path: os.path.exists(path / member)


def _axes_of_uvh5(path: Path) -> tuple[FloatArray, FloatArray]:
    with reading(path, "uvh5"), h5py.File(path, "r") as file:
        times, freqs = (np.ravel(file[f"Header/{name}_array"][()]).astype(float) for name in ("time", "freq"))
    return times, freqs


FORMATS = {
    "uvh5": Format(
        "a uvh5 file",
        _begins_with(b"\x89HDF\r\n\x1a\n"),
        in_part=True,
        sample_by_sample=True,
        check=check_uvh5,
        axes=_axes_of_uvh5,
    ),
    "uvfits": Format("a uvfits file", _begins_with(b"SIMPLE  ="), in_part=True),
    "ms": Format("a measurement set", _has("OBSERVATION"), is_talkative=True, needs=("casacore", "python-casacore")),
    "miriad": Format("a miriad file", _has("vartable"), is_talkative=True),
}
READ_IN_PART = tuple(kind for kind, one in FORMATS.items() if one.in_part)
