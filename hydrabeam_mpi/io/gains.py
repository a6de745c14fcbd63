"""Calibration solutions (calfits or calh5), applied to visibilities.

The gains g of a file obey V_obs = g_i g_j* V_true ("divide") or V_true = g_i g_j* V_obs ("multiply"); the
file says which. Here they are always the former.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pyuvdata import UVCal
from pyuvdata.utils import jnum2str
from pyuvdata.uvcal.calfits import CALFITS

from hydrabeam_mpi.data.limits import LARGEST
from hydrabeam_mpi.data.observation import BoolArray, ComplexArray, FloatArray, IntArray, Observation
from hydrabeam_mpi.data.partition import Tile
from hydrabeam_mpi.data.selection import match
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.gain_cover import Cover, check_all_there, cover_of, nearest, say_lacking
from hydrabeam_mpi.io.reading import check_file, reading
from hydrabeam_mpi.io.uvdata import feeds_of, size


@dataclass(frozen=True)
class _Solution(Cover):
    """The gains of one file, ``gains`` and ``flags`` being (Nchannels, Nsolutions, Nants, Nfeeds)."""

    gains: ComplexArray
    flags: BoolArray


def apply_gains(
    data: ComplexArray, flags: BoolArray, observation: Observation, tile: Tile, gain_files: Sequence[Path]
) -> tuple[ComplexArray, BoolArray, FloatArray]:
    """Calibrate the visibilities of a tile: V_true = V_obs / (g_i g_j*).

    Parameters
    ----------
    data, flags : ndarray, (Nfreqs, len(tile.times), len(tile.bls), Npols)
    observation : Observation
    tile : Tile
    gain_files : sequence of Path
        Together they must have every antenna, channel and feed, and some solution within an integration of every
        time. What none of them has there is flagged. A single solution serves all times. What they say of the
        convention of polarisation counts for visibilities whose files say nothing; these end as V = 1/2 I B.

    Returns
    -------
    data, flags : ndarray, same shape
        Flagged, and zero, where the data or one of the gains is.
    power : ndarray, same shape
        |g_i g_j*|^2, the variance of V_obs over that of V_true.

    Raises
    ------
    InputError
        If a gain is missing, or neither flagged nor finite and nonzero, or visibilities get beyond reason by it.
    """
    return calibrate(data, flags, observation, tile.times, observation.antpairs[tile.bls], gain_files)


def calibrate(
    data: ComplexArray,
    flags: BoolArray,
    observation: Observation,
    times: IntArray,
    antpairs: IntArray,
    gain_files: Sequence[Path],
    pols: Sequence[str] | None = None,
) -> tuple[ComplexArray, BoolArray, FloatArray]:
    """Calibrate any baselines, (a, a) being an autocorrelation; see `apply_gains`."""
    gains, gain_flags = read_gains(gain_files, observation, times)
    feeds = feeds_of(observation.pols)
    ant_1, ant_2 = match(antpairs, observation.antenna_numbers, 0).T
    data, flags, power = np.array(data), np.array(flags), np.ones(data.shape)
    for index, pol in enumerate(pols or observation.pols):
        end_1 = (..., ant_1, feeds.index(pol[0]))
        end_2 = (..., ant_2, feeds.index(pol[1]))
        product = gains[end_1] * gains[end_2].conj()
        data[..., index] /= product
        power[..., index] = np.abs(product) ** 2
        flags[..., index] |= gain_flags[end_1] | gain_flags[end_2]
    largest = np.max(size(data), where=~flags, initial=0.0)
    if largest > LARGEST:
        message = f"makes a visibility of {largest:.1e} Jy, which no source and no transmitter has"
        raise InputError(message, file=gain_files[0], field="gain_array", remedy="correct or flag the gains")
    return np.where(flags, 0.0, data), flags, power


def read_gains(files: Sequence[Path], observation: Observation, times: IntArray) -> tuple[ComplexArray, BoolArray]:
    """Read gains in the sense of V_obs = g_i g_j* V_true, each time from the nearest solution.

    Returns
    -------
    gains, flags : ndarray, (Nfreqs, len(times), Nants, Nfeeds)
        Of the observation's antennas and of the feeds in its polarisations; one where flagged or in no file.
    """
    feeds, wanted = feeds_of(observation.pols), observation.times[times]
    shape = (observation.Nfreqs, len(times), observation.Nants, len(feeds))
    gains, flags = np.ones(shape, np.complex128), np.ones(shape, bool)
    distance = np.full(shape, np.inf)
    solutions = [_read_solution(Path(path), observation) for path in files]
    check_all_there(solutions, observation, files[0])
    for solution, near in nearest(solutions, observation, times):
        at = np.flatnonzero(near >= 0)
        away = np.abs(solution.times[near[at]] - wanted[at])[:, np.newaxis]
        here = np.ix_(solution.channels, at, solution.ants)
        for index, feed in enumerate(feeds):
            stored = solution.place(feed)
            if stored is None:
                continue
            best = distance[..., index]
            better = away < best[here]
            for filled, found in ((gains, solution.gains), (flags, solution.flags)):
                of_feed = filled[..., index]
                of_feed[here] = np.where(better, found[..., stored][:, near[at]], of_feed[here])
            best[here] = np.where(better, away, best[here])
    nowhere = np.isinf(distance).all(axis=(0, 2))
    if nowhere.any():
        time, feed = np.argwhere(nowhere)[0]
        raise InputError(
            f'no gains of feed "{feeds[feed]}" within an integration of JD {wanted[time]:.6f}',
            file=files[0],
            field="[data] gains",
            remedy="add the gain file of that time and feed",
        )
    return gains, flags


def mean_gains(files: Sequence[Path], observation: Observation) -> ComplexArray:
    """Return the means over an observation's times of the gains of its first feed; NaN where all are flagged.

    Returns
    -------
    ndarray of complex, (Nfreqs, Nants)
    """
    gains, flags = read_gains(files, observation, np.arange(observation.Ntimes))
    number = np.sum(~flags[..., 0], axis=1)
    total = np.sum(gains[..., 0], axis=1, where=~flags[..., 0])
    return np.where(number > 0, total / np.maximum(number, 1), np.nan)


def doubt_about_gains(files: Sequence[Path], observation: Observation) -> str | None:
    """Say of how much no file has gains, by what they say of themselves.

    Raises
    ------
    InputError
        If a file cannot be read, or an antenna or a channel is in none.
    """
    covers = []
    for path in map(Path, files):
        cal = _read_uvcal(path, observation, read_data=False)
        with reading(path, "gains"):
            covers.append(cover_of(cal, observation))
    check_all_there(covers, observation, files[0])
    return say_lacking(covers, observation)


def antennas_of(path: Path, observation: Observation) -> IntArray:
    """Return the numbers of the antennas that a file has gains of."""
    return np.asarray(_read_uvcal(path, observation, read_data=False).ant_array)


def _read_solution(path: Path, observation: Observation) -> _Solution:
    """Read one gain file and pick the observation's antennas and channels."""
    cal = _read_uvcal(path, observation)
    with reading(path, "gains"):
        return _picked(cal, path, observation)


def _picked(cal: UVCal, path: Path, observation: Observation) -> _Solution:
    """Pick the observation's antennas and channels, and make the gains such as multiply the true visibilities."""
    cover = cover_of(cal, observation)
    # pyuvdata has (Nants, Nfreqs, Ntimes, Njones).
    here = np.ix_(*cover.stored[::-1])
    gains = cal.gain_array[here].transpose(1, 2, 0, 3).astype(np.complex128)
    flags = cal.flag_array[here].transpose(1, 2, 0, 3)
    _check_values(gains, flags, observation.antenna_numbers[cover.ants], path)
    gains[flags] = 1.0
    if cal.gain_convention == "multiply":
        gains = 1 / gains
    if cal.pol_convention is not None:
        gains *= _left_by_reading(cal.pol_convention, observation, path)
    return _Solution(**vars(cover), gains=gains, flags=flags)


def _left_by_reading(stated: str, observation: Observation, path: Path) -> float:
    """Return by what gains are multiplied to calibrate to V = 1/2 I B, given the convention of calibrated data.

    Reading has halved visibilities said to be in the convention I = (V_xx + V_yy) / 2, by their files or by the job.
    The gains' own statement replaces the job's, and cannot differ from that of files, as in
    `pyuvdata.utils.uvcalibrate`.
    """
    if others := set(observation.stated_conventions) - {stated, None}:
        message = f'says "{stated}", where visibilities that it is applied to say "{others.pop()}"'
        remedy = "correct the one that is wrong, UVCal.pol_convention or UVData.pol_convention"
        raise InputError(message, file=path, field="pol_convention", remedy=remedy)
    if observation.convention is None:
        message = f'says "{stated}", as do some files of visibilities, while those that say nothing are taken otherwise'
        remedy = f'set [data] pol_convention = "{stated}"'
        raise InputError(message, file=path, field="pol_convention", remedy=remedy)
    return float(np.sqrt(2) ** ((stated == "avg") - (observation.convention == "avg")))


def _check_values(gains: ComplexArray, flags: BoolArray, antennas: IntArray, path: Path) -> None:
    """Refuse gains by which no visibility can be divided, unless flagged; (Nfreqs, Ntimes, Nants, ...)."""
    usable = (size(gains) >= 1 / LARGEST) & (size(gains) <= LARGEST)
    unusable = ~flags & ~usable
    if unusable.any():
        ant = antennas[np.argwhere(unusable)[0, 2]]
        message = f"an unflagged gain of antenna {ant} is zero, not finite, or beyond reason ({gains[unusable][0]:.3g})"
        raise InputError(message, file=path, field="gain_array", remedy="flag it")


def _read_uvcal(path: Path, observation: Observation, read_data: bool = True) -> UVCal:
    """Read a gain file, or what it says of itself, never asking the network where the telescope is."""
    check_file(path, field="[data] gains")
    with reading(path, "gains", remedy="give calfits or calh5 files, or write this one again"):
        with path.open("rb") as file:
            is_hdf5 = file.read(4) == b"\x89HDF"
        if is_hdf5:
            cal = UVCal()
            cal.read_calh5(str(path), read_data=read_data, run_check=False, background_lsts=False)
        else:
            # Older calfits files do not say where the telescope is, and pyuvdata would look its name up
            # on the network. It does not where the object that reads knows the place already.
            cal = CALFITS()
            cal.telescope.location = observation.location
            cal.read_calfits(str(path), read_data=read_data, run_check=False, background_lsts=False)
        _check_header(cal)
        if read_data:
            _check_parts(cal)
    return cal


def _check_header(cal: UVCal) -> None:
    """Make sure that the file holds gains by channel, of feeds that there are."""
    if cal.cal_type != "gain" or cal.wide_band:
        remedy = "convert it with UVCal.convert_to_gain()"
        raise InputError("not gains by channel", field="cal_type", remedy=remedy)
    if cal.gain_convention not in ("divide", "multiply"):
        told = f'is "{cal.gain_convention}", not "divide" or "multiply"'
        raise InputError(told, field="gain_convention", remedy="correct the file")
    for code in cal.jones_array:
        try:
            jnum2str(int(code))
        except KeyError:
            told = f"no feeds have the code {int(code)}"
            raise InputError(told, field="jones_array", remedy="correct the file") from None


def _check_parts(cal: UVCal) -> None:
    """Make sure that the arrays fit together."""
    shape = (len(cal.ant_array), len(cal.freq_array), cal.Ntimes, len(cal.jones_array))
    n_times = len(cal.time_array if cal.time_range is None else cal.time_range)
    for field in ("gain_array", "flag_array"):
        found = getattr(cal, field).shape
        if found != shape or n_times != cal.Ntimes:
            told = f"has the shape {found}, but the header tells {shape}"
            raise InputError(told, field=field, remedy="write the file again")
    if cal.flag_array.dtype != bool:
        raise InputError("is not true or false", field="flag_array", remedy="write the file again with pyuvdata")
    if cal.gain_array.dtype.kind != "c":
        raise InputError("is not complex", field="gain_array", remedy="write the file again with pyuvdata")
