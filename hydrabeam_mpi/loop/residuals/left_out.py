"""Where the rows are that changes of the weights leave out: which times, antennas and baselines lost more than others.

An entry of an axis has lost more than its share if so many of its n rows are improbable with the rate of all others,

    P(at least k of n) * number of entries < `SIGNIFICANT_P`        (binomial).

The most improbable are named, and of what remains again, until nothing stands out: so that an antenna is named rather
than its baselines, and a baseline rather than its antennas, whichever explains more.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from hydrabeam_mpi.data.observation import BoolArray, FloatArray, IntArray
from hydrabeam_mpi.data.runs import runs_of
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.state import Fitted
from hydrabeam_mpi.inference.significance import SIGNIFICANT_P
from hydrabeam_mpi.mpi import allreduce_sum, together
from hydrabeam_mpi.words import joined

MOST_NAMED, MOST_LISTED = 4, 64


def rows_left_out(context: FitContext, fitted: Fitted) -> dict[str, Any] | None:
    """Tell which fitted and held-out rows changes of the weights leave out; None where none do.

    Collective: all ranks of the grid.

    Returns
    -------
    dict
        ``n`` rows of ``of``, all channels together; ``times`` (stretches of neighbouring ones: ``jd`` of the first and
        the last, ``integrations``), ``antennas`` and ``baselines`` (``what``) that lost more than their share, each
        with ``n`` and ``of``; what was left out of all others, ``elsewhere``, with the first of these ``rows``
        (``baseline``, ``jd``); and ``sentence``.
    """
    if not any(one.change.leaves_out for one in fitted.values.reweighted):
        return None
    lost, had = _losses(context, fitted)
    observation, ends = context.setup.observation, context.setup.observation.antenna_index
    # In several channels a row is lost for one reason.
    rows = np.array([lost > 0, had > 0], dtype=float)
    named = [np.zeros(n, dtype=bool) for n in (observation.Ntimes, observation.Nants, observation.Nbls)]
    while (found := _most_improbable(_by_axis(rows, ends))) is not None:
        named[found[0]] |= found[1]
        rows[:, named[0]] = 0.0
        rows[:, :, named[1][ends].any(axis=1) | named[2]] = 0.0
    whole, rest = (_by_axis(np.array([lost, had]) * kept, ends) for kept in (1, rows[1] > 0))
    pairs, numbers = observation.antpairs.tolist(), observation.antenna_numbers.tolist()
    late, antennas, bls = named
    told: dict[str, Any] = {
        **_numbers(whole[0].sum(axis=1)),
        "times": [
            {"jd": observation.times[[span[0], span[-1]]].tolist(), "integrations": len(span)}
            | _numbers(whole[0][:, span].sum(axis=1))
            for span in _stretches(late, context.setup.times)
        ],
        "antennas": [{"what": numbers[k]} | _numbers(whole[1][:, k]) for k in np.flatnonzero(antennas)],
        "baselines": [{"what": pairs[k]} | _numbers(whole[2][:, k]) for k in np.flatnonzero(bls)],
        "elsewhere": _numbers(rest[0].sum(axis=1))
        | {
            "rows": [
                {"baseline": pairs[k], "jd": float(observation.times[t])}
                for t, k in np.argwhere((rows[1] > 0) & (lost > 0))[:MOST_LISTED].tolist()
            ]
        },
    }
    return {**told, "sentence": _sentence(told)}


def _losses(context: FitContext, fitted: Fitted) -> tuple[IntArray, IntArray]:
    """Return in how many channels rows were left out, and in how many there are data, (Ntimes, Nbls).

    Collective: all ranks of the grid.
    """
    observation = context.setup.observation
    counts = np.zeros((2, observation.Ntimes, observation.Nbls), dtype=int)
    with together(context.grid.world):
        for share in (context.train, context.test):
            rows, _ = share.calibrated(fitted.estimate)
            had = share.rows.inv_noise_var > 0
            place = np.ix_(share.rows.tile.times, share.rows.tile.bls)
            for total, counted in zip(counts, (had & (rows.inv_noise_var == 0), had), strict=True):
                total[place] += counted.sum(axis=0)
    allreduce_sum(context.grid.world, counts)
    return counts[0], counts[1]


def _by_axis(rows: FloatArray, ends: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Add up counts, (2, Ntimes, Nbls), by times, antennas and baselines, (2, N) each."""
    by_bl = rows.sum(axis=1)
    n = int(ends.max()) + 1
    antennas = np.array([sum(np.bincount(end, of_bls, n) for end in ends.T) for of_bls in by_bl])
    return rows.sum(axis=2), antennas, by_bl


def _most_improbable(axes: Sequence[FloatArray]) -> tuple[int, BoolArray] | None:
    """Return which axis, and which of its entries, stand out most: those that are at least half as improbable in ln."""
    log_p = [log_chance(*counts) for counts in axes]
    best = int(np.argmin([one.min(initial=0.0) for one in log_p]))
    least = float(log_p[best].min(initial=0.0))
    if not least < np.log(SIGNIFICANT_P):
        return None
    return best, log_p[best] < min(0.5 * least, float(np.log(SIGNIFICANT_P)))


def log_chance(lost: FloatArray, n: FloatArray) -> FloatArray:
    """Return ln of the probability that any entry loses as many of its rows by chance, with the others' rate, (N,).

    Parameters
    ----------
    lost, n : ndarray, (N,)
        How many rows each has lost, and how many it had.
    """
    from scipy.stats import binom  # takes long to import, which only what gets here needs

    others_lost, others = lost.sum() - lost, n.sum() - n
    # Of others that have lost none nobody knows more than that one in so many would be no surprise.
    rate = np.minimum(np.maximum(others_lost, 1.0) / np.maximum(others, 1.0), 1.0)
    some = (lost > 0) & (others > 0)
    had = np.maximum(n, 1.0)
    # The tail is zero in doubles where a whole integration is lost and no other row is; its first term is not.
    tail = np.maximum(binom.logsf(lost - 1, had, rate), binom.logpmf(lost, had, rate))
    log_p: FloatArray = np.where(some, tail, 0.0)
    return log_p + math.log(max(int(np.count_nonzero(n)), 1))


def _stretches(late: BoolArray, times: IntArray) -> list[IntArray]:
    """Return the times that are named, in stretches of neighbours among all ``times`` that are looked at."""
    return [times[run] for run in runs_of(np.flatnonzero(late[times]))]


def _numbers(counts: FloatArray) -> dict[str, int]:
    return {"n": round(float(counts[0])), "of": round(float(counts[1]))}


def _sentence(told: dict[str, Any]) -> str:
    """Say where the rows are that are left out."""
    names = [
        *(f"{_share(one)} of {_stretch(one)}" for one in _largest(told["times"])),
        *(f"{_share(one)} of antenna {one['what']}" for one in _largest(told["antennas"])),
        *(f"{_share(one)} of baseline {one['what'][0]}-{one['what'][1]}" for one in _largest(told["baselines"])),
    ]
    unnamed = sum(max(len(told[axis]) - MOST_NAMED, 0) for axis in ("times", "antennas", "baselines"))
    names += [f"more of {unnamed} others than chance has"] if unnamed else []
    head, rest = f"{told['n']:,} of {told['of']:,} visibilities ({_share(told)}) are left out", told["elsewhere"]
    single = [f"baseline {a}-{b} at JD {one['jd']:.6f}" for one in rest["rows"] for a, b in [one["baseline"]]]
    where = f" ({joined(single)})" if 0 < len(single) <= MOST_NAMED else ""
    if not names:
        return f"{head}, no more of any time, antenna or baseline than chance has{where}."
    return f"{head}: {joined(names)}; {rest['n']:,} elsewhere, as chance has them{where}."


def _largest(found: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return those with most rows left out, in their order."""
    last = sorted(-one["n"] for one in found)[:MOST_NAMED][-1:]
    return [one for one in found if -one["n"] <= last[0]][:MOST_NAMED]


def _stretch(one: dict[str, Any]) -> str:
    first, last = one["jd"]
    if one["integrations"] == 1:
        return f"JD {first:.6f}"
    return f"JD {first:.6f} to {last:.6f} ({one['integrations']} integrations)"


def _share(one: dict[str, Any]) -> str:
    return f"{100 * one['n'] / max(one['of'], 1):.3g}%"
