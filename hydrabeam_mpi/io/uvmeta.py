"""The metadata of many files of visibilities as one observation.

Files may split the data in any way: by time, night, channel, polarisation or baseline.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray, IntArray, Observation
from hydrabeam_mpi.data.selection import Selection, distinct, select_baselines, select_channels, select_times
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.mounts import check_mounts, doubt_about_mounts
from hydrabeam_mpi.io.uvfile import FREQ_TOLERANCE, TIME_TOLERANCE, UVHeader, check_all_survive
from hydrabeam_mpi.io.uvsource import Data, Source, files_among
from hydrabeam_mpi.io.uvsurvey import Survey, pair_keys, survey
from hydrabeam_mpi.io.uvtogether import check_covered, check_disjoint, doubts_about, merge_antennas


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
    resolved = [os.path.realpath(path) for path in files_among(files)]
    if len(set(resolved)) < len(resolved):
        raise InputError("a file is named twice", field="[data] files", remedy="name it once")
    check_all_survive([Path(data) for data in files if not isinstance(data, Source)])
    surveys = survey(files)
    names, positions = merge_antennas(surveys)
    stated = tuple({one.header.pol_convention: None for one in surveys})
    surveys = [one for one in surveys if one.antpairs.size]
    if not surveys:
        raise InputError("no cross-correlations", file=files[0], field="ant_2_array", remedy="add their files")
    check_disjoint(surveys)
    antpairs = _select_antpairs(surveys, positions, selection)
    numbers, headers = np.unique(antpairs), [one.header for one in surveys]
    check_mounts(headers, numbers)

    freqs, channel_width = (
        np.concatenate([getattr(one.header, name) for one in surveys]) for name in ("freqs", "channel_width")
    )
    first = distinct(freqs, FREQ_TOLERANCE)
    channels = first[select_channels(freqs[first], channel_width[first], selection)]

    stamps = np.concatenate([[one.times, one.lsts, one.integration_time] for one in surveys], axis=1)
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
        pols=_select_pols(headers, selection),
        stated_conventions=stated,
        is_phased=any(header.is_phased for header in headers),
        uncalibrated=any(header.units == "uncalib" for header in headers),
    )
    check_covered(observation, surveys)
    of_mounts = doubt_about_mounts(headers, numbers)
    return replace(observation, doubts=(*doubts_about(observation, surveys), *([of_mounts] if of_mounts else [])))


def _select_antpairs(surveys: list[Survey], positions: dict[int, FloatArray], selection: Selection) -> IntArray:
    """Merge the baselines of all files, keep the selected ones and make sure that each has a vector."""
    antpairs = np.unique(np.concatenate(list({id(one.antpairs): one.antpairs for one in surveys}.values())), axis=0)
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
            f"only the polarisations {', '.join(pols)}, and the model is of products of linear feeds",
            file=path,
            field="polarization_array",
            remedy="give the data of which these are sums, such as ee and nn or xx and yy",
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
