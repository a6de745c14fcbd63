"""Visibilities written as a uvh5 file."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import h5py
import numpy as np
from pyuvdata import Telescope, UVData
from pyuvdata.utils import polstr2num

from hydrabeam_mpi.data.observation import Array, BoolArray, ComplexArray, FloatArray, IntArray, Observation
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.disk import replacing
from hydrabeam_mpi.io.hdf5 import HDF5Target
from hydrabeam_mpi.io.reading import quiet
from hydrabeam_mpi.io.uvdata import Block, feeds_of
from hydrabeam_mpi.io.uvfile import enu_axes

Writer = Callable[..., None]
"""Writes some times; see `uvh5_in_parts`."""


def write_uvh5(
    path: Path,
    observation: Observation,
    data: ComplexArray,
    flags: BoolArray,
    nsamples: FloatArray,
    autos: FloatArray | None = None,
) -> None:
    """Write drift-scan visibilities in Jy; the file appears whole or not at all.

    Parameters
    ----------
    path : Path
        Replaced if it exists.
    observation : Observation
    data, flags, nsamples : ndarray, (Nfreqs, Ntimes, Nbls, Npols)
        In the convention V = 1/2 I B, which the file states as ``pol_convention = "sum"``. The format keeps
        nsamples in single precision.
    autos : ndarray, (Nfreqs, Ntimes, Nants, Nfeeds), optional
        Autocorrelations of the feeds ``feeds_of(observation.pols)`` in Jy; flagged where not finite, and for
        cross-hand polarisations.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    with uvh5_in_parts(path, observation, autos is not None, "Written by hydrabeam_mpi.") as write:
        block = None if autos is None else Block.of_power(autos)
        write(np.arange(observation.Ntimes), data, flags, nsamples, block)


@contextmanager
def uvh5_in_parts(path: Path, observation: Observation, has_autos: bool, history: str) -> Iterator[Writer]:
    """Give a function that writes some times of visibilities; the file appears whole or not at all.

    Parameters
    ----------
    path : Path
        Replaced if it exists.
    observation : Observation
    has_autos : bool
        Whether the file has autocorrelations.
    history : str

    Yields
    ------
    callable
        Called with indices of successive times, and with what `write_uvh5` is given, of these times; autocorrelations
        are a `Block`.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    antpairs = observation.antpairs
    if has_autos:
        antpairs = np.concatenate([antpairs, np.repeat(observation.antenna_numbers[:, None], 2, axis=1)])
    try:
        with replacing(path) as hidden, _Target(hidden) as target:
            with quiet():
                _as_uvdata(observation, antpairs, history).initialize_uvh5_file(target)
            with h5py.File(target, "r+") as file:
                yield partial(_write_part, file["Data"], observation, len(antpairs))
            target.settle()
    except OSError as error:
        raise InputError(f"cannot be written ({error})", file=path, remedy="choose another place") from error


def _write_part(
    group: h5py.Group,
    observation: Observation,
    n_rows: int,
    times: IntArray,
    data: ComplexArray,
    flags: BoolArray,
    nsamples: FloatArray,
    autos: Block | None = None,
) -> None:
    """Write successive times, of which the file has ``n_rows`` rows each."""
    block = Block(data, flags, nsamples, ~flags)
    if autos is not None:
        block = Block(*map(_joined, block, _auto_block(observation, autos)))
    rows = slice(int(times[0]) * n_rows, (int(times[-1]) + 1) * n_rows)
    for name, values in (("visdata", block.data), ("flags", block.flags), ("nsamples", block.nsamples)):
        shape = (observation.Nfreqs, len(times), n_rows, observation.Npols)
        if values.shape != shape:
            raise ValueError(f"{name} of the shape {values.shape}, not {shape}")
        group[name][rows] = values.transpose(1, 2, 0, 3).reshape(-1, observation.Nfreqs, observation.Npols)


class _Target(HDF5Target):
    """Has a name to show to pyuvdata, which asks whether such a file is there already."""

    def __fspath__(self) -> str:
        return ""


def _joined(cross: Array, auto: Array) -> Array:
    """Put autocorrelations behind the cross-correlations, along the axis of baselines."""
    return np.concatenate([cross, auto], axis=2)


def _auto_block(observation: Observation, autos: Block) -> Block:
    """Give autocorrelations by feed the polarisation axis of the visibilities."""
    feeds = feeds_of(observation.pols)
    nothing = Block.of_power(np.full(autos.data.shape[:3], np.nan))

    def by_pol(values: Array, none: Array) -> Array:
        of_each = [values[..., feeds.index(pol[0])] if pol[0] == pol[1] else none for pol in observation.pols]
        return np.stack(of_each, axis=-1)

    return Block(*map(by_pol, autos, nothing))


def telescope_of(observation: Observation) -> tuple[Telescope, dict[str, str]]:
    """Return the telescope as pyuvdata knows it, and the orientation of its feeds as an argument."""
    # Feeds named by direction are written as x (east) and y (north); others have no known direction.
    directed = set("".join(observation.pols)) <= {"e", "n"}
    orientation = {"x_orientation": "east"} if directed else {}
    names = observation.antenna_names
    if len(set(names)) < len(names):
        # Files have been read by numbers, and pyuvdata takes no name twice.
        names = tuple(map(str, observation.antenna_numbers.tolist()))
    telescope = Telescope.new(
        name=observation.telescope_name,
        location=observation.location,
        antenna_positions=observation.antpos @ enu_axes(observation.location),
        antenna_names=list(names),
        antenna_numbers=observation.antenna_numbers,
        instrument=observation.telescope_name,
        mount_type="fixed",
        update_from_known=False,
        **orientation,
    )
    return telescope, orientation


def _as_uvdata(observation: Observation, antpairs: Array, history: str) -> UVData:
    """Build the pyuvdata object without data, time by time and within a time baseline by baseline."""
    telescope, orientation = telescope_of(observation)
    uv = UVData.new(
        freq_array=observation.freqs,
        polarization_array=np.array([polstr2num(pol, **orientation) for pol in observation.pols]),
        times=observation.times,
        telescope=telescope,
        antpairs=antpairs,
        do_blt_outer=True,
        time_axis_faster_than_bls=False,
        integration_time=observation.integration_time,
        channel_width=observation.channel_width,
        update_telescope_from_known=False,
        vis_units="Jy",
        pol_convention="sum",
        history=history,
    )
    uv.lst_array = np.repeat(observation.lsts, len(antpairs))
    uv.phase_center_app_ra = uv.lst_array.copy()
    return uv
