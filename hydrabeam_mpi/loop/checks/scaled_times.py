"""Single integrations on a scale of their own, as one that was counted twice."""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.data.observation import IntArray
from hydrabeam_mpi.inference.robust import MOST_EXCEPTIONS
from hydrabeam_mpi.loop.checks.conventions import AMPLITUDE_TOLERANCE, LEFT, MIN_FALL
from hydrabeam_mpi.loop.checks.health_sums import Excess, Sums
from hydrabeam_mpi.setup.findings import Finding, integration_words
from hydrabeam_mpi.setup.problem import Problem


def scaled_times(problem: Problem, times: IntArray, sums: Sums, excess: Excess) -> list[Finding]:
    """Find integrations of which the model beam explains most with a factor of their own, which neighbours do not have.

    Gains that all antennas have in common are such a factor, and are left to the loop where they last for longer than
    an integration. So may be a bright source whose flux is wrong, as it passes: without the brightest source in what
    the model leaves there has to be more of that than at all other times. Where times follow each other closely enough
    for differences these tell.

    Parameters
    ----------
    problem : Problem
        Of all channels.
    times : ndarray of int, (Ntimes,)
        Those of the sample.
    sums : Sums
        Of what counts.
    excess : Excess
        Of data beside the model.
    """
    if excess.differenced:
        return []
    overlap, model, data = sums.time_products
    own = np.divide(overlap, model, out=np.zeros_like(overlap), where=model.real > 0)
    scale, power = sums.scale[:, np.newaxis], model.real
    # What its own factor leaves, and what that of all data leaves besides.
    left = np.sum(data.real - np.abs(own) ** 2 * power - sums.time_counts, axis=0)
    falls = np.sum(np.abs(own - scale) ** 2 * power, axis=0)
    of_all = np.sum(np.abs(scale) ** 2 * power, axis=0)
    of_own = np.sum(np.abs(own) ** 2 * power, axis=0)
    factor = np.sqrt(np.divide(of_own, of_all, out=np.ones_like(left), where=of_all > 0))
    off = (falls > MIN_FALL) & (left < LEFT * (left + falls)) & (np.abs(factor - 1) > AMPLITUDE_TOLERANCE)
    alone = np.flatnonzero(off & ~np.append(off[1:], False) & ~np.append(False, off[:-1]))
    total, n = excess.times
    logs = np.where(n > 0, total / np.maximum(n, 1), -np.inf)
    alone = alone[logs[alone] > np.delete(logs, alone).max(initial=-np.inf)]
    if len(alone) > MOST_EXCEPTIONS * len(times):
        return []
    return [_of_time(problem, int(times[t]), float(factor[t])) for t in alone.tolist()]


def _of_time(problem: Problem, time: int, factor: float) -> Finding:
    observation, one = problem.observation, slice(time, time + 1)
    name, remedy, span = integration_words(observation.times[one], observation.integration_time[one])
    why = f"the model beam explains it when it is {factor:.3g} times as large as at other times"
    return Finding("an integration on another scale", name, why, remedy, times=(span,))
