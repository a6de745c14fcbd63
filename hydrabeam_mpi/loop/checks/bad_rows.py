"""Bad integrations and baselines, among fitted and held-out rows alike."""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray, IntArray
from hydrabeam_mpi.data.runs import runs_of
from hydrabeam_mpi.inference.robust import LOG_STD, MOST_EXCEPTIONS, known_median, outliers
from hydrabeam_mpi.loop.checks.health_sums import Excess, Sums
from hydrabeam_mpi.setup.findings import Finding, baseline_words, integration_words
from hydrabeam_mpi.setup.problem import Problem
from hydrabeam_mpi.words import from_to


def bad_times(problem: Problem, times: IntArray, sums: Sums, excess: Excess) -> list[Finding]:
    """Find integrations that are all zero, or that stand out from the others on most baselines.

    A second difference has three integrations in it: bad is one of which all differences stand out, and the worst of
    neighbours that blame each other; another look tells whether what is left of the others does. Those that follow each
    other are told as one. ``times``, (Nlooks,), are those of the sample.
    """
    counted = sums.time_counts.sum(axis=0)
    power = sums.time_products[2].real.sum(axis=0)
    bad = np.flatnonzero((counted > 0) & (power == 0)).tolist()
    ratios = sigmas = np.zeros(0)
    if not bad:
        total, n = excess.times
        logs = np.where(n > 0, total / np.maximum(n, 1), np.nan)
        absurd = np.maximum(outliers(logs, LOG_STD / np.sqrt(np.maximum(n, 1))), 0.0)
        worst = sorted(_worst(excess, absurd, n > 0, len(times)))
        bad, looks = [t for t, _ in worst], [look for _, look in worst]
        ratios, sigmas = np.exp(logs[looks] - known_median(logs)), absurd[looks]
    if len(bad) > MOST_EXCEPTIONS * len(times):
        return []
    found = []
    for run in runs_of(times[bad]):
        why = f"all {'its' if len(run) == 1 else 'their'} visibilities are zero"
        if len(ratios):
            ratio, sigma = (one[np.isin(times[bad], run)] for one in (ratios, sigmas))
            power = from_to(f"{ratio.min():.2g}", f"{ratio.max():.2g}")
            why = f"{excess.says} has {power} times the power of others"
            why += f" ({from_to(f'{sigma.min():.0f}', f'{sigma.max():.0f}')} sigma)"
        found.append(_of_times(problem, run, why))
    return found


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


def _of_times(problem: Problem, times: IntArray, reason: str) -> Finding:
    """Return what is found of integrations that follow each other, (n,)."""
    observation = problem.observation
    name, remedy, span = integration_words(observation.times[times], observation.integration_time[times])
    held_out = np.isin(times, problem.test.times) & ~np.isin(times, problem.train.times)
    roles = [role for role, any_is in (("fitted", not held_out.all()), ("held out", held_out.any())) if any_is]
    what = "a bad integration" if len(times) == 1 else f"{len(times)} bad integrations"
    return Finding(what, f"{name}, {' and '.join(roles)}", reason, remedy, times=(span,))


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
