"""What is flagged of corrected data besides what was flagged before: which, why, and in words."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydrabeam_mpi.api.result import Result
from hydrabeam_mpi.data.observation import IntArray, Observation
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.left_out import LeftOut, leaves_out, restore_changes
from hydrabeam_mpi.io.inferred import Inferred
from hydrabeam_mpi.mpi import Comm, bcast_object, together
from hydrabeam_mpi.setup.earlier import integrations_of
from hydrabeam_mpi.setup.problem import Problem
from hydrabeam_mpi.terminal.progress import say
from hydrabeam_mpi.words import counted, joined

UNKNOWN = "the result does not tell the gains at these times"
BAD = "bad antennas"


def left_out_here(world: Comm, problem: Problem, result: Result, context: FitContext) -> LeftOut | None:
    """Return what a result left out of its own data, where these are them; None where nothing or of other data.

    Collective: all ranks of `world`.
    """
    inferred, asks = None, False
    with together(world):
        if world.rank == 0:
            inferred = Inferred.of(result.content, result.path)
            asks = leaves_out(inferred)
    if not world.bcast(asks):
        return None
    own, left = integrations_of(world, problem.files, problem.observation), None
    with together(world):
        if inferred and _are_its_own(own, inferred):
            left = restore_changes(inferred, context.setup)
    found: LeftOut | None = bcast_object(world, left)
    return found


def _are_its_own(integrations: list[str], result: Inferred) -> bool:
    """Whether a result was made from integrations, by their checksums, rather than one that was its prior."""
    about = result.content.provenance
    known = about.get("integrations", [])
    last = known[-len(integrations) :] if "sha256_before" in about else known
    return bool(integrations) and set(integrations) <= set(last)


def flagged_told(
    observation: Observation,
    gain_flags: NDArray[np.bool_],
    bad_antennas: Collection[int],
    left: LeftOut | None,
    lost: IntArray,
) -> list[dict[str, Any]]:
    """Say and return what is flagged.

    Parameters
    ----------
    observation : Observation
    gain_flags : ndarray of bool, (Nfreqs, Ntimes, Nants)
    bad_antennas : collection of int
        Their numbers.
    left : LeftOut, optional
    lost : ndarray of int, (2, Ntimes)
        How many visibilities of each time it leaves out, and of how many.

    Returns
    -------
    list of dict
        ``why``; the numbers of ``antennas``, or how many ``visibilities``; and ``times_jd``, those at which it is, or
        of visibilities those of which nothing is left, where these are not all times. In any channel.
    """
    told = [*_of_antennas(observation, gain_flags, bad_antennas), *(_of_rows(observation, left, lost) if left else ())]
    for one in told:
        antennas, times = one.get("antennas", ()), one.get("times_jd", ())
        what = f"antenna{'s' * (len(antennas) > 1)} {joined(list(map(str, antennas)))}"
        when = f" at {len(times)} of {observation.Ntimes} times" if times else ""
        if not antennas:
            what = f"{one['visibilities']:,} visibilities"
            when = f", among them all of {counted(len(times), 'time')}" if times else ""
        say(f"flagged: {what}{when}: {one['why']}")
    return told


def _of_rows(observation: Observation, left: LeftOut, lost: IntArray) -> list[dict[str, Any]]:
    """Tell of visibilities that are left out."""
    whole = (lost[0] > 0) & (lost[0] == lost[1])
    why = f"the result left them out ({joined(list(left.titles.values()))})"
    told = {"why": why, "visibilities": int(lost[0].sum()), "times_jd": observation.times[whole].tolist()}
    return [told] if told["visibilities"] else []


def _of_antennas(
    observation: Observation, gain_flags: NDArray[np.bool_], bad_antennas: Collection[int]
) -> list[dict[str, Any]]:
    """Tell of antennas that are bad, and of those whose gains are not known."""
    numbers: IntArray = observation.antenna_numbers
    told: list[dict[str, Any]] = []
    if bad := sorted(set(bad_antennas) & set(numbers.tolist())):
        told.append({"why": BAD, "antennas": bad})
    by_times: dict[bytes, list[int]] = {}
    at_times = gain_flags.any(axis=0) & ~np.isin(numbers, bad)
    for antenna in np.flatnonzero(at_times.any(axis=0)).tolist():
        by_times.setdefault(at_times[:, antenna].tobytes(), []).append(antenna)
    for antennas in by_times.values():
        times = observation.times[at_times[:, antennas[0]]].tolist()
        told.append({"why": UNKNOWN, "antennas": numbers[antennas].tolist(), "times_jd": times})
    return told
