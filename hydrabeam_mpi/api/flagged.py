"""What is flagged of corrected data besides what was flagged before: which, why, and in words."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydrabeam_mpi.data.observation import Observation
from hydrabeam_mpi.terminal.progress import say
from hydrabeam_mpi.words import joined

UNKNOWN = "the result does not tell the gains at these times"
BAD = "bad antennas"


def flagged_told(
    observation: Observation, gain_flags: NDArray[np.bool_], bad_antennas: Collection[int]
) -> list[dict[str, Any]]:
    """Say and return what is flagged.

    Parameters
    ----------
    observation : Observation
    gain_flags : ndarray of bool, (Nfreqs, Ntimes, Nants)
    bad_antennas : collection of int
        Their numbers.

    Returns
    -------
    list of dict
        ``why``, ``antennas`` (numbers), and ``times_jd`` where that is not all of them, in any channel.
    """
    numbers, told = observation.antenna_numbers, []
    if bad := sorted(set(bad_antennas) & set(numbers.tolist())):
        told.append({"why": BAD, "antennas": bad})
    by_times: dict[bytes, list[int]] = {}
    at_times = gain_flags.any(axis=0) & ~np.isin(numbers, bad)
    for antenna in np.flatnonzero(at_times.any(axis=0)).tolist():
        by_times.setdefault(at_times[:, antenna].tobytes(), []).append(antenna)
    for antennas in by_times.values():
        times = observation.times[at_times[:, antennas[0]]].tolist()
        told.append({"why": UNKNOWN, "antennas": numbers[antennas].tolist(), "times_jd": times})
    for one in told:
        when = f" at {len(one['times_jd'])} of {observation.Ntimes} times" if "times_jd" in one else ""
        names = joined(list(map(str, one["antennas"])))
        say(f"flagged: antenna{'s' * (len(one['antennas']) > 1)} {names}{when}: {one['why']}")
    return told
