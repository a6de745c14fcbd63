"""The metadata of many files of visibilities as one observation.

Files may split the data in any way: by time, night, channel, polarisation or baseline.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray, IntArray, Observation
from hydrabeam_mpi.data.selection import Selection, distinct, match, select_baselines, select_channels, select_times
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.uvfile import UVHeader, file_kind
from hydrabeam_mpi.io.uvformat import FORMATS
from hydrabeam_mpi.io.uvsource import Data, Source, as_source, files_among
from hydrabeam_mpi.io.uvwhole import check_survives

# Stamps closer than this are one integration or one channel; both far exceed the rounding of any format.
TIME_TOLERANCE = 1e-3 / 86400  # days
FREQ_TOLERANCE = 1.0  # Hz
# Positions of one antenna in several files.
POSITION_TOLERANCE = 1e-3  # metres


@dataclass(frozen=True)
class _Survey:
    """What is kept of a file while all are looked at: the distinct baselines and times among its rows."""

    header: UVHeader
    antpairs: IntArray
    times: FloatArray
    lsts: FloatArray
    integration_time: FloatArray


def pair_keys(antpairs: IntArray) -> IntArray:
    """Return one integer a baseline; their order is that of (ant1, ant2)."""
    return (antpairs[:, 0] << 32) + antpairs[:, 1]


def _survey(source: Source) -> _Survey:
    """Reduce the metadata of a file to its distinct baselines and times."""
    header, rows = source.metadata()
    _check_channels(header)
    cross = np.flatnonzero(rows.antpairs[:, 0] != rows.antpairs[:, 1])
    keys, baseline = np.unique(pair_keys(rows.antpairs[cross]), return_inverse=True)
    _check_averaging(header.path, rows.integration_time[cross], baseline)
    first = cross[distinct(rows.times[cross], TIME_TOLERANCE)]
    return _Survey(
        header,
        np.stack([keys >> 32, keys & 0xFFFFFFFF], axis=1),
        rows.times[first],
        rows.lsts[first],
        rows.integration_time[first],
    )


def _check_channels(header: UVHeader) -> None:
    """Refuse a file with two channels at one frequency, of which the data would be those of one."""
    if len(distinct(header.freqs, FREQ_TOLERANCE)) < len(header.freqs):
        freqs = np.sort(header.freqs)
        twice = freqs[1:][np.diff(freqs) <= FREQ_TOLERANCE][0]
        raise InputError(
            f"two channels at {twice / 1e6:.6f} MHz",
            file=header.path,
            field="freq_array",
            remedy="keep one with UVData.select(freq_chans=[...]), or correct the frequencies",
        )


def _check_averaging(path: Path, integration_time: FloatArray, baseline: IntArray) -> None:
    """Refuse baseline-dependent averaging: one time axis must serve all baselines."""
    mean = np.bincount(baseline, integration_time) / np.bincount(baseline)
    if mean.size and np.ptp(mean) > 0.01 * mean.max():
        raise InputError(
            f"integrations of {mean.min():g} to {mean.max():g} s, depending on the baseline",
            file=path,
            field="integration_time",
            remedy="undo the averaging with UVData.upsample_in_time()",
        )


def read_observation(files: Sequence[Data], selection: Selection) -> Observation:
    """Read the metadata of all files and apply a selection to them.

    The antennas are those of the selected baselines. Sidereal times are the files' own.

    Parameters
    ----------
    files : sequence of Path or Source
        uvh5, uvfits, measurement sets or miriad, also mixed, or data in memory. Some may hold
        autocorrelations only, which have no say in the axes.
    selection : Selection

    Returns
    -------
    Observation
        Times and channels ascend; baselines are sorted by antenna numbers and keep their orientation.

    Raises
    ------
    InputError
        If a file cannot be used, the files do not fit together, or the selection leaves nothing.
    """
    if not files:
        raise InputError("no files", field="[data] files", remedy="name at least one")
    paths = files_among(files)
    resolved = [os.path.realpath(path) for path in paths]
    if len(set(resolved)) < len(resolved):
        raise InputError("a file is named twice", field="[data] files", remedy="name it once")
    kinds = {path: file_kind(path) for path in paths}
    for kind in sorted(set(kinds.values())):
        if FORMATS[kind].is_talkative:
            check_survives([path for path in paths if kinds[path] == kind], kind)
    surveys = [_survey(as_source(data)) for data in files]
    names, positions = _merge_antennas([survey.header for survey in surveys])
    surveys = [survey for survey in surveys if survey.antpairs.size]
    if not surveys:
        raise InputError("no cross-correlations", file=files[0], field="ant_2_array", remedy="add their files")
    antpairs = _select_antpairs(surveys, positions, selection)
    numbers = np.unique(antpairs)

    freqs, channel_width = (
        np.concatenate([getattr(survey.header, name) for survey in surveys]) for name in ("freqs", "channel_width")
    )
    first = distinct(freqs, FREQ_TOLERANCE)
    channels = first[select_channels(freqs[first], channel_width[first], selection)]

    stamps = np.concatenate([[survey.times, survey.lsts, survey.integration_time] for survey in surveys], axis=1)
    stamps = stamps[:, distinct(stamps[0], TIME_TOLERANCE)]
    times, lsts, integration_time = stamps[:, select_times(stamps[0], stamps[1], selection)]

    observation = Observation(
        telescope_name=surveys[0].header.telescope_name,
        location=surveys[0].header.location,
        antenna_numbers=numbers,
        antenna_names=tuple(names[number] for number in numbers.tolist()),
        antpos=np.array([positions[number] for number in numbers.tolist()]),
        antpairs=antpairs,
        freqs=freqs[channels],
        channel_width=channel_width[channels],
        times=times,
        lsts=lsts,
        integration_time=integration_time,
        pols=_select_pols([survey.header for survey in surveys], selection),
        uncalibrated=any(survey.header.units == "uncalib" for survey in surveys),
    )
    _check_covered(observation, surveys)
    return observation


def _geocentric(header: UVHeader) -> FloatArray:
    return np.array([axis.to_value("m") for axis in header.location.to_geocentric()])


def _merge_antennas(headers: list[UVHeader]) -> tuple[dict[int, str], dict[int, FloatArray]]:
    """Collect the antennas of all files, by number, and make sure that they are those of one array."""
    names: dict[int, str] = {}
    positions: dict[int, FloatArray] = {}
    origin = _geocentric(headers[0])
    for header in headers:
        moved = np.linalg.norm(_geocentric(header) - origin)
        if moved > POSITION_TOLERANCE:
            raise InputError(
                f"a telescope {moved:.3g} m away from that of {headers[0].path.name}",
                file=header.path,
                field="telescope_location",
                remedy="give files of one array",
            )
        for number, name, position in zip(
            header.antenna_numbers.tolist(), header.antenna_names, header.antpos, strict=True
        ):
            shift = np.linalg.norm(position - positions.setdefault(number, position))
            if shift > POSITION_TOLERANCE:
                raise InputError(
                    f"antenna {number} stands {shift:.3g} m away from where earlier files have it",
                    file=header.path,
                    field="antenna_positions",
                    remedy="give files of one array",
                )
            names.setdefault(number, name)
    return names, positions


def _select_antpairs(surveys: list[_Survey], positions: dict[int, FloatArray], selection: Selection) -> IntArray:
    """Merge the baselines of all files, keep the selected ones and make sure that each has a vector."""
    antpairs = np.unique(np.concatenate([survey.antpairs for survey in surveys]), axis=0)
    nowhere = np.full(3, np.nan)
    ends = np.array([[positions.get(ant, nowhere) for ant in pair] for pair in antpairs.tolist()])
    keep = select_baselines(antpairs, ends[:, 1] - ends[:, 0], selection, idle=positions)
    antpairs, ends = antpairs[keep], ends[keep]

    path, field = surveys[0].header.path, "antenna_positions"
    without = antpairs[~np.isfinite(ends).all(axis=2)]
    if without.size:
        raise InputError(
            f"antenna {without[0]} has no position",
            file=path,
            field=field,
            remedy="leave it out with exclude_antennas",
        )
    same = antpairs[np.all(ends[:, 0] == ends[:, 1], axis=1)]
    if same.size:
        raise InputError(
            f"antennas {same[0, 0]} and {same[0, 1]} share one position",
            file=path,
            field=field,
            remedy="correct it",
        )
    both = antpairs[np.isin(pair_keys(antpairs), pair_keys(antpairs[:, ::-1]))]
    if both.size:
        raise InputError(
            f"baseline ({both[0, 0]}, {both[0, 1]}) is stored in both orientations",
            file=path,
            field="ant_1_array",
            remedy="unify them with UVData.conjugate_bls()",
        )
    return antpairs


def linear_pols(pols: Sequence[str], path: Path) -> list[str]:
    """Return the polarisations that the model can describe, those of linear feeds.

    Raises
    ------
    InputError
        If there is none, as in data in Stokes parameters.
    """
    linear = [pol for pol in pols if len(pol) == 2 and set(pol) <= set("enxy")]
    if not linear:
        raise InputError(
            f"only the polarisations {', '.join(pols)}, and the beam is that of a linear feed",
            file=path,
            field="polarization_array",
            remedy="give data of linear feeds, such as xx and yy",
        )
    return linear


def _select_pols(headers: list[UVHeader], selection: Selection) -> tuple[str, ...]:
    """Return the polarisations to read, under the names that the files have for them."""
    known = dict.fromkeys(pol for header in headers for pol in header.pols)
    if selection.pols is None:
        return tuple(known)
    pols: list[str] = []
    for pol in selection.pols:
        found = {header.pols[header.pol_index(pol)] for header in headers if header.pol_index(pol) >= 0}
        if len(found) != 1:
            listed = " or ".join(f'"{name}"' for name in linear_pols(tuple(known), headers[0].path))
            silent = "the file does not tell where its feeds point; " if known.keys() & {"xx", "yy"} else ""
            raise InputError(
                f'no polarisation "{pol}"',
                file=headers[0].path,
                field="polarization_array",
                remedy=f"{silent}ask for polarization = {listed}",
            )
        pols += found
    return tuple(dict.fromkeys(pols))


def _check_covered(observation: Observation, surveys: list[_Survey]) -> None:
    """Make sure that the files hold every channel and polarisation at every time."""
    covered = np.zeros((observation.Ntimes, observation.Nfreqs, observation.Npols), dtype=bool)
    for survey in surveys:
        at_time = match(observation.times, survey.times, TIME_TOLERANCE) >= 0
        at_freq = match(observation.freqs, survey.header.freqs, FREQ_TOLERANCE) >= 0
        with_pol = np.array([survey.header.pol_index(pol) >= 0 for pol in observation.pols])
        covered |= at_time[:, None, None] & at_freq[:, None] & with_pol
    if not covered.all():
        time, freq, pol = np.argwhere(~covered)[0]
        raise InputError(
            f'no file holds "{observation.pols[pol]}" at {observation.freqs[freq] / 1e6:.6f} MHz'
            f" and JD {observation.times[time]:.6f}",
            field="[data] files",
            remedy="give files with the same channels and polarisations at all times",
        )
