"""Tables of sigma, the noise of one sample in Jy, by channel and perhaps by antenna."""

from __future__ import annotations

import zipfile
from pathlib import Path

import h5py
import numpy as np

from hydrabeam_mpi.data.limits import LARGEST
from hydrabeam_mpi.data.observation import Array, FloatArray, IntArray, Observation
from hydrabeam_mpi.data.selection import match
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.reading import check_file, reading

_FIELDS = ("freqs", "sigma", "antennas")


def read_table(path: Path) -> dict[str, Array] | None:
    """Read a table of sigma; None where the file is no such table but something else.

    Parameters
    ----------
    path : Path
        HDF5 or npz with ``freqs`` (Nfreqs,) in Hz and ``sigma``, (Nfreqs,) or (Nants, Nfreqs), in Jy; the latter goes
        with ``antennas`` (Nants,), their numbers. Where sigma is not known it may be NaN or zero.

    Raises
    ------
    InputError
        If there is no such file, it is damaged, or its columns do not fit together.
    """
    if path.is_dir():
        return None
    check_file(path, field="[noise] file")
    with reading(path, "a table of sigma", field="[noise] file"):
        table = _columns(path)
        if table is not None:
            _check_columns(table)
    return table


def _columns(path: Path) -> dict[str, Array] | None:
    if zipfile.is_zipfile(path):
        with np.load(path) as file:
            return {name: np.asarray(file[name]) for name in _FIELDS if name in file.files}
    if h5py.is_hdf5(path):
        with h5py.File(path, "r") as file:
            if "sigma" in file:
                return {name: np.asarray(file[name][()]) for name in _FIELDS if name in file}
    return None


def _check_columns(table: dict[str, Array]) -> None:
    by_antenna = "sigma" in table and table["sigma"].ndim == 2
    axes = ("antennas", "freqs") if by_antenna else ("freqs",)
    for field in ("sigma", *axes):
        if field not in table:
            raise InputError("is missing", field=field, remedy="add it to the table")
        if table[field].dtype.kind not in "iuf":
            raise InputError(
                f"holds values of type {table[field].dtype}, not numbers", field=field, remedy="correct it"
            )
    for field in axes:
        values = table[field]
        if values.ndim != 1 or not np.isfinite(values).all() or len(np.unique(values)) < len(values):
            told = "is no list of numbers each of which is there once"
            raise InputError(told, field=field, remedy="correct it")
    shape = tuple(len(table[field]) for field in axes)
    if table["sigma"].shape != shape:
        told = f"has the shape {table['sigma'].shape}, but {' and '.join(axes)} make {shape}"
        raise InputError(told, field="sigma", remedy="give one sigma for each")
    sigma = table["sigma"]
    if np.any((sigma < 0) | (sigma > LARGEST)):
        wrong = sigma[(sigma < 0) | (sigma > LARGEST)][0]
        raise InputError(f"a sigma of {wrong:.3g} Jy", field="sigma", remedy="correct it, or NaN where it is not known")


def table_sigma(table: dict[str, Array], path: Path, observation: Observation, bls: IntArray) -> FloatArray:
    """Return the sigma of one sample of some baselines, (Nfreqs, 1, 1 or len(bls), 1) in Jy.

    Raises
    ------
    InputError
        If a channel or an antenna is not in the table.
    """
    channels = match(observation.freqs, table["freqs"], 0.5 * observation.channel_width)
    if np.any(channels < 0):
        missing = f"{observation.freqs[channels < 0][0] / 1e6:.6f} MHz"
        raise InputError(f"no sigma at {missing}", file=path, field="freqs", remedy="add that channel")
    sigma = np.asarray(table["sigma"], dtype=float)[..., channels]
    if sigma.ndim == 1:
        return sigma[:, None, None, None]
    antpairs = observation.antpairs[bls]
    ants = match(antpairs, table["antennas"], 0)
    if np.any(ants < 0):
        missing = antpairs[ants < 0][0]
        raise InputError(f"no sigma of antenna {missing}", file=path, field="antennas", remedy="add it")
    return np.sqrt(sigma[ants[:, 0]] * sigma[ants[:, 1]]).T[:, None, :, None]
