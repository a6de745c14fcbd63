"""Bad integrations and baselines, among fitted and held-out rows alike."""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray, IntArray
from hydrabeam_mpi.inference.robust import LOG_STD, MOST_EXCEPTIONS, known_median, outliers
from hydrabeam_mpi.loop.checks.health_sums import Excess, Sums
from hydrabeam_mpi.setup.findings import Finding, baseline_words, integration_words
from hydrabeam_mpi.setup.problem import Problem


def bad_times(problem: Problem, times: IntArray, sums: Sums, excess: Excess) -> list[Finding]:
    """Find integrations that are all zero, or that stand out from the others on most baselines.

    A second difference has three integrations in it: bad is one of which all differences stand out, and the worst of
    neighbours that blame each other; another look tells whether what is left of the others does. ``times``, (Nlooks,),
    are those of the sample.
    """
    counted = sums.time_counts.sum(axis=0)
    power = sums.time_products[2].real.sum(axis=0)
    why = {int(t): "all its visibilities are zero" for t in np.flatnonzero((counted > 0) & (power == 0))}
    if not why:
        total, n = excess.times
        logs = np.where(n > 0, total / np.maximum(n, 1), np.nan)
        absurd = np.maximum(outliers(logs, LOG_STD / np.sqrt(np.maximum(n, 1))), 0.0)
        worst = _worst(excess, absurd, n > 0, len(times))
        for t, look in worst:
            ratio = np.exp(logs[look] - known_median(logs))
            why[t] = f"{excess.says} has {ratio:.2g} times the power of others ({absurd[look]:.0f} sigma)"
    few = len(why) <= MOST_EXCEPTIONS * len(times)
    return [_of_time(problem, int(times[t]), reason) for t, reason in sorted(why.items())] if few else []


def _worst(excess: Excess, absurd: FloatArray, known: np.ndarray, n_times: int) -> list[tuple[int, int]]:
    """Return bad times and the looks that show each best."""
    if not excess.differenced:
        return [(int(k), int(k)) for k in np.flatnonzero(absurd)]
    reach = {
        t: [k for k in np.flatnonzero(np.abs(excess.middle - t) <= 1).tolist() if known[k]] for t in range(n_times)
    }
    blamed = {t: looks for t, looks in reach.items() if looks and all(absurd[k] > 0 for k in looks)}
    chosen: list[tuple[int, int]] = []
    # That with most differences against it first; what shares one with it waits for another look.
    for t in sorted(blamed, key=lambda t: (-len(blamed[t]), -sum(absurd[k] for k in blamed[t]))):
        if all(abs(t - other) > 2 for other, _ in chosen):
            chosen.append((t, max(blamed[t], key=lambda k: absurd[k])))
    return chosen


def _of_time(problem: Problem, time: int, reason: str) -> Finding:
    observation = problem.observation
    name, remedy, span = integration_words(float(observation.times[time]), float(observation.integration_time[time]))
    role = "held out" if time in problem.test.times and time not in problem.train.times else "fitted"
    return Finding("a bad integration", f"{name}, {role}", reason, remedy, times=(span,))


def bad_baselines(problem: Problem, sums: Sums, excess: Excess) -> list[Finding]:
    """Find baselines that are all zero or constant, or whose changes in time stand out from the others'.

    Only differences in time tell of noise: what is constant in time, or slow, is for effects to describe.
    """
    antpairs = problem.observation.antpairs
    counted = sums.bl_counts.sum(axis=0)
    why = {int(b): "all its visibilities are zero" for b in np.flatnonzero((counted > 0) & (sums.zeros == counted))}
    for b in np.flatnonzero((sums.pairs > 1) & (sums.steps == 0)).tolist():
        why.setdefault(b, "all its visibilities are constant")
    if excess.differenced:
        total, n = excess.bls
        logs = np.where(n > 0, total / np.maximum(n, 1), np.nan)
        # Differences that share a time are worth half as many.
        absurd = outliers(logs, LOG_STD / np.sqrt(np.maximum(n / 2, 1)))
        for b in np.flatnonzero(absurd > 0).tolist():
            ratio = np.exp(logs[b] - known_median(logs))
            why.setdefault(
                b,
                f"its changes in time have {ratio:.2g} times the others' power ({absurd[b]:.0f} sigma)",
            )
    if len(why) > MOST_EXCEPTIONS * np.count_nonzero(counted):
        return []
    found = []
    for b, reason in sorted(why.items()):
        one, two = (int(ant) for ant in antpairs[b])
        name, remedy = baseline_words(one, two)
        found.append(Finding("a bad baseline", name, reason, remedy, baselines=((one, two),)))
    return found
