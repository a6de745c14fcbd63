"""Of which antennas, channels, times and feeds files have gains."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from pyuvdata import UVCal
from pyuvdata.utils import jnum2str

from hydrabeam_mpi.data.observation import FloatArray, IntArray, Observation
from hydrabeam_mpi.data.selection import match
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.uvdata import feeds_of
from hydrabeam_mpi.io.uvfile import FREQ_TOLERANCE, TIME_TOLERANCE

AT_ONCE = 32_000_000
"""Gains of which it is told together whether there are any, a byte each."""


@dataclass(frozen=True)
class Cover:
    """What one file has gains of, among what is observed.

    Attributes
    ----------
    channels, ants : ndarray of int, (Nchannels,) and (Nants,)
        Indices into the observation's.
    stored : (ndarray of int, ndarray of int), (Nchannels,) and (Nants,)
        Where the file has them.
    times : ndarray, (Nsolutions,)
        JD.
    reach : float
        Days about its time for which each solution holds.
    feeds : tuple of frozenset of str
        Names of each Jones element's feed: "x", and "e" where the file tells its direction.
    """

    channels: IntArray
    ants: IntArray
    stored: tuple[IntArray, IntArray]
    times: FloatArray
    reach: float
    feeds: tuple[frozenset[str], ...]

    def place(self, feed: str) -> int | None:
        """Return which Jones element is that of a feed."""
        return next((place for place, names in enumerate(self.feeds) if feed in names), None)


OneCover = TypeVar("OneCover", bound=Cover)


def cover_of(cal: UVCal, observation: Observation) -> Cover:
    """Return what a file has gains of."""
    channels = match(observation.freqs, cal.freq_array, FREQ_TOLERANCE)
    ants = match(observation.antenna_numbers, cal.ant_array, 0)
    orientation = cal.telescope.get_x_orientation_from_feeds()
    names = ({jnum2str(j)[1:], jnum2str(j, x_orientation=orientation)[1:]} for j in cal.jones_array)
    times, reach = np.asarray(cal.time_array), float(np.max(cal.integration_time, initial=0.0) / 86400)
    if cal.time_range is not None:
        times, reach = np.mean(cal.time_range, axis=1), float(np.ptp(cal.time_range, axis=1).max() / 2)
    return Cover(
        channels=np.flatnonzero(channels >= 0),
        ants=np.flatnonzero(ants >= 0),
        stored=(channels[channels >= 0], ants[ants >= 0]),
        times=times,
        reach=reach,
        feeds=tuple(frozenset(name[0] for name in both if name[0] == name[1]) for both in names),
    )


def nearest(
    covers: Sequence[OneCover], observation: Observation, times: IntArray
) -> Iterator[tuple[OneCover, IntArray]]:
    """Yield each file with its solution nearest to each of some times, (len(times),), -1 where it is too far."""
    wanted = observation.times[times]
    lone = np.ptp(np.concatenate([cover.times for cover in covers])) <= TIME_TOLERANCE
    for cover in covers:
        reach = np.maximum(cover.reach, observation.integration_time[times] / 86400)
        yield cover, match(wanted, cover.times, np.inf if lone else reach)


def check_all_there(covers: Sequence[Cover], observation: Observation, path: Path) -> None:
    """Refuse antennas and channels of which no file has gains."""
    ants = np.setdiff1d(np.arange(observation.Nants), np.concatenate([cover.ants for cover in covers]))
    if ants.size:
        missing = ", ".join(map(str, observation.antenna_numbers[ants]))
        remedy = "leave it out with exclude_antennas"
        raise InputError(f"no gains of antenna {missing}", file=path, field="ant_array", remedy=remedy)
    channels = np.setdiff1d(np.arange(observation.Nfreqs), np.concatenate([cover.channels for cover in covers]))
    if channels.size:
        missing = f"{observation.freqs[channels[0]] / 1e6:.6f} MHz"
        remedy = "give gains with the channels of the data"
        raise InputError(f"no gains at {missing}", file=path, field="freq_array", remedy=remedy)


def say_lacking(covers: Sequence[Cover], observation: Observation) -> str | None:
    """Say how much has no gains, which counts as flagged."""
    feeds = feeds_of(observation.pols)
    of_a_time = observation.Nfreqs * observation.Nants * len(feeds)
    lacking = np.zeros(observation.Nants, dtype=int)
    for times in np.array_split(np.arange(observation.Ntimes), -(-observation.Ntimes * of_a_time // AT_ONCE)):
        covered = np.zeros((observation.Nfreqs, len(times), observation.Nants, len(feeds)), dtype=bool)
        for cover, near in nearest(covers, observation, times):
            here = np.ix_(cover.channels, np.flatnonzero(near >= 0), cover.ants)
            for index, feed in enumerate(feeds):
                if cover.place(feed) is not None:
                    covered[..., index][here] = True
        lacking += np.sum(~covered, axis=(0, 1, 3))
    if not lacking.any():
        return None
    ants = observation.antenna_numbers[lacking > 0].tolist()
    which = "all antennas" if len(ants) == observation.Nants else f"antenna {', '.join(map(str, ants))}"
    percent = 100 * lacking.sum() / (observation.Ntimes * of_a_time)
    return (
        f"The files of gains lack {percent:.2g}% of the gains, of {which} at some times or channels: data of these "
        "count as flagged."
    )
