"""One file of visibilities, whatever its format: what kind it is and what it says of its data."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from astropy.coordinates import EarthLocation
from pyuvdata import UVData
from pyuvdata.utils import polnum2str

from hydrabeam_mpi.compiled import keep_compiled
from hydrabeam_mpi.data.observation import FloatArray, IntArray
from hydrabeam_mpi.data.selection import match
from hydrabeam_mpi.errors import InputError, printable
from hydrabeam_mpi.io.reading import check_file, mute, reading
from hydrabeam_mpi.io.uvcheck import check_metadata
from hydrabeam_mpi.io.uvformat import FORMATS, READ_IN_PART
from hydrabeam_mpi.io.uvwhole import check_survives

keep_compiled()

# Stamps closer than this are one integration or one channel; both far exceed the rounding of any format.
TIME_TOLERANCE = 1e-3 / 86400  # days
FREQ_TOLERANCE = 1.0  # Hz
# Phase centres of pyuvdata that keep their place above the ground.
STANDING = ("unprojected", "driftscan")


@dataclass(frozen=True)
class UVRows:
    """What a file says of each of its rows, a row being a baseline at a time.

    Attributes
    ----------
    antpairs : ndarray of int, (Nblts, 2)
        As stored; autocorrelations included.
    times, lsts, integration_time : ndarray, (Nblts,)
        JD, radians, seconds.
    """

    antpairs: IntArray
    times: FloatArray
    lsts: FloatArray
    integration_time: FloatArray


@dataclass(frozen=True)
class UVHeader:
    """What a file says of all its rows.

    Attributes
    ----------
    path : Path
    kind : str
        One of `FORMATS`, or "memory".
    telescope_name : str
    location : astropy.coordinates.EarthLocation
    antenna_numbers : ndarray of int, (Nants,)
    antenna_names : tuple of str
    antpos : ndarray, (Nants, 3)
        Metres ENU.
    mounts : tuple of str, (Nants,)
        As pyuvdata names them; empty where the file does not tell.
    freqs, channel_width : ndarray, (Nfreqs,)
        Hz.
    n_windows : int
        Spectral windows that the channels are of.
    pols : tuple of str
        Named by the direction of the feeds ("ee") where the file tells it, by the feeds ("xx") otherwise.
    feed_pols : tuple of str
        Named by the feeds.
    units : str
        "Jy", or "uncalib" of visibilities that are not calibrated.
    pol_convention : {"sum", "avg"} or None
        As the file states it.
    is_phased : bool
        Whether visibilities are stored as those that follow a place on the sky.
    history : str
        What has been done to the data, by the file.
    """

    path: Path
    kind: str
    telescope_name: str
    location: EarthLocation
    antenna_numbers: IntArray
    antenna_names: tuple[str, ...]
    antpos: FloatArray
    mounts: tuple[str, ...]
    freqs: FloatArray
    channel_width: FloatArray
    n_windows: int
    pols: tuple[str, ...]
    feed_pols: tuple[str, ...]
    units: str
    pol_convention: str | None
    is_phased: bool
    history: str = ""

    def pol_index(self, pol: str) -> int:
        """Return where a polarisation is stored, by either of its names, or -1."""
        for names in (self.pols, self.feed_pols):
            if pol in names:
                return names.index(pol)
        return -1


def enu_axes(location: EarthLocation) -> FloatArray:
    """Return the unit vectors east, north and up at a place, the rows of a matrix, (3, 3), in ECEF.

    Relative ECEF positions turn into ENU by this matrix alone. Adding the Earth's radius first, as general
    conversions do, would cost a nanometre.
    """
    lon, lat = location.lon.rad, location.lat.rad
    return np.array(
        [
            [-np.sin(lon), np.cos(lon), 0.0],
            [-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)],
            [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)],
        ]
    )


def file_kind(path: Path) -> str:
    """Tell the format of a file by its content.

    Returns
    -------
    str
        One of `FORMATS`.

    Raises
    ------
    InputError
        If it is missing, unreadable, truncated or none of these.
    """
    is_folder = os.path.isdir(path)
    if not is_folder:
        check_file(path)
    for kind, one in FORMATS.items():
        if one.is_of(path):
            if one.check is not None:
                one.check(path)
            return kind
    *others, last = (one.called for one in FORMATS.values())
    told = "a folder that holds no visibilities" if is_folder else "not a uvh5 file"
    if not is_folder and not path.stat().st_size:
        told = "an empty file"
    raise InputError(told, file=path, remedy=f"give {', '.join(others)} or {last}")


def check_all_survive(paths: Sequence[Path]) -> None:
    """Make sure that files can be read of whose formats the libraries may end the process.

    Raises
    ------
    InputError
        If one cannot.
    """
    kinds = {path: file_kind(path) for path in paths}
    for kind in sorted(set(kinds.values())):
        if FORMATS[kind].is_talkative:
            check_survives([path for path in paths if kinds[path] == kind], kind)


def may_hold(path: Path, times: FloatArray, freqs: FloatArray) -> bool:
    """Tell quickly that a file has nothing at some times (JD), (Ntimes,), or at some frequencies (Hz), (Nfreqs,).

    True where only all metadata can tell.
    """
    axes = FORMATS[file_kind(path)].axes
    if axes is None:
        return True
    wanted = (times, TIME_TOLERANCE), (freqs, FREQ_TOLERANCE)
    return all(np.any(match(here, axis, near) >= 0) for (axis, near), here in zip(wanted, axes(path), strict=True))


def read_uvdata(path: Path, kind: str, **select: Any) -> UVData:
    """Read through pyuvdata, without its checks: they are slow, and this module's own name the remedy."""
    one = FORMATS[kind]
    if one.needs is not None and find_spec(one.needs[0]) is None:
        raise InputError(f"{one.called}, which {one.needs[1]} reads", file=path, remedy=f"install {one.needs[1]}")
    uv = UVData()
    # Of a measurement set with one channel nothing would be left.
    options = {"run_check": False, "background_lsts": False, "remove_flex_pol": False, "ignore_single_chan": False}
    with reading(path, kind), mute() if one.is_talkative else nullcontext():
        uv.read(str(path), file_type=kind, **options, **select)
    return uv


def read_metadata(path: Path) -> tuple[UVHeader, UVRows]:
    """Read what a file says about its visibilities, and not more of them than its format demands.

    Raises
    ------
    InputError
        If the file is missing, damaged, of another format, or its data are of a kind that the model lacks.
    """
    kind = file_kind(path)
    uv = read_uvdata(path, kind, **({"read_data": False} if kind in READ_IN_PART else {}))
    with reading(path, kind):
        check_metadata(uv, path)
        return header_of(uv, path, kind), rows_of(uv)


def header_of(uv: UVData, path: Path, kind: str) -> UVHeader:
    """Return what is said of all rows."""
    telescope = uv.telescope
    orientation = telescope.get_x_orientation_from_feeds()
    return UVHeader(
        path=path,
        kind=kind,
        telescope_name=printable(str(telescope.name)),
        location=telescope.location,
        antenna_numbers=np.asarray(telescope.antenna_numbers, dtype=np.int64),
        antenna_names=tuple(map(str, telescope.antenna_names)),
        antpos=np.asarray(telescope.antenna_positions, dtype=float) @ enu_axes(telescope.location).T,
        mounts=() if telescope.mount_type is None else tuple(map(str, telescope.mount_type)),
        freqs=np.asarray(uv.freq_array, dtype=float),
        channel_width=np.abs(np.asarray(uv.channel_width, dtype=float)),
        n_windows=int(uv.Nspws),
        pols=tuple(polnum2str(number, x_orientation=orientation) for number in uv.polarization_array),
        feed_pols=tuple(polnum2str(number) for number in uv.polarization_array),
        units=str(uv.vis_units),
        pol_convention=uv.pol_convention,
        is_phased=any(centre["cat_type"] not in STANDING for centre in uv.phase_center_catalog.values()),
        history=str(uv.history or ""),
    )


def rows_of(uv: UVData) -> UVRows:
    """Return what is said of each row."""
    return UVRows(
        antpairs=np.stack([uv.ant_1_array, uv.ant_2_array], axis=1).astype(np.int64),
        times=np.asarray(uv.time_array, dtype=float),
        lsts=np.asarray(uv.lst_array, dtype=float),
        integration_time=np.asarray(uv.integration_time, dtype=float),
    )
