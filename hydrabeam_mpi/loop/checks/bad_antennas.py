"""Dead and absurd antennas: by their autocorrelations, where the noise is taken from these, and by visibilities."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import median_filter

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.inference.robust import known_median, outliers
from hydrabeam_mpi.io.noise import odd_autocorrelations
from hydrabeam_mpi.loop.checks.health_sums import Sample, Sums
from hydrabeam_mpi.mpi import ProcessGrid, allreduce_sum
from hydrabeam_mpi.setup.findings import Finding, antenna_words
from hydrabeam_mpi.setup.problem import Problem

NOISE_SIGMAS = 5.0
"""Power of a baseline below so many standard deviations of the noise's is none: it counts as just that."""
MOST_LEFT_OUT = 0.5
"""Of more antennas than this share none is an exception, and none is left out."""


def absurd_autocorrelations(grid: ProcessGrid, problem: Problem, sample: Sample) -> list[Finding]:
    """Find antennas whose autocorrelations are no power, or absurd beside the others'. Collective: all ranks."""
    n_freqs, n_ants = problem.observation.Nfreqs, problem.observation.Nants
    sums = np.zeros((3, n_freqs, n_ants))
    known, positive = ~np.isnan(sample.autos), sample.autos > 0
    logs = np.log(np.where(positive, sample.autos, 1.0))
    for k, values in enumerate((known, positive, logs)):
        sums[k, sample.channels] = values.sum(axis=1)
    allreduce_sum(grid.world, sums)
    n_known, n_positive, log_power = sums
    mean = np.where(n_positive > 0, log_power / np.maximum(n_positive, 1), -np.inf)
    dead = (n_known.sum(axis=0) > 0) & (n_positive.sum(axis=0) == 0)
    return _left_out(problem, odd_autocorrelations(_over_channels(np.where(n_known > 0, mean, np.nan)), dead))


def absurd_antennas(problem: Problem, sums: Sums) -> list[Finding]:
    """Find antennas whose visibilities are all zero, all constant, or of absurd power for what the model expects."""
    index = problem.observation.antenna_index
    counted = sums.bl_counts.sum(axis=0)
    zero = (counted > 0) & (sums.zeros == counted)
    constant = (sums.pairs > 0) & (sums.steps == 0)
    power = _power(problem, sums)
    n_ants = problem.observation.Nants
    by_antenna, why = np.full(n_ants, np.nan), {}
    for ant in range(n_ants):
        mine = (index == ant).any(axis=1) & (counted > 0)
        if not mine.any():
            continue
        if zero[mine].all():
            why[ant] = "all its visibilities are zero"
        elif constant[mine].all():
            why[ant] = "all its visibilities are constant"
        by_antenna[ant] = known_median(power[mine])
    absurd = outliers(by_antenna)
    for ant in np.flatnonzero(absurd).tolist():
        ratio = np.exp(by_antenna[ant] - known_median(by_antenna))
        words = f"the power of its visibilities is {ratio:.2g} of the others'" if ratio > 0 else "it has no power"
        why.setdefault(ant, f"{words}, beside what the model expects ({abs(absurd[ant]):.0f} sigma)")
    return _left_out(problem, why)


def _power(problem: Problem, sums: Sums) -> FloatArray:
    """Return ln of power beyond the noise over the model's, beside baselines of like length, (Nbls,); -inf: none."""
    _, model, data = sums.bl_products
    beyond = np.maximum(data.real - sums.bl_counts, NOISE_SIGMAS * np.sqrt(sums.bl_counts))
    known = (sums.bl_counts > 0) & (model.real > 0)
    # No data at all are less than what noise hides.
    logs = np.where(data.real > 0, np.log(np.where(known, beyond / np.where(known, model.real, 1.0), 1.0)), -np.inf)
    by_baseline = _over_channels(np.where(known, logs, np.nan))
    # What a model lacks of diffuse emission is on short baselines, and an antenna in the centre has no others.
    observation = problem.observation
    order = np.argsort(np.linalg.norm(observation.bl_vectors, axis=1), kind="stable")
    order = order[~np.isnan(by_baseline[order])]
    of_length = median_filter(by_baseline[order], size=2 * observation.Nants, mode="nearest")
    by_baseline[order] -= np.where(np.isfinite(of_length), of_length, 0.0)
    return by_baseline


def _over_channels(logs: FloatArray) -> FloatArray:
    """Return medians over channels, (N,), of logs (Nfreqs, N) beside the others'; NaN where nothing is known."""
    found = np.full(logs.shape[1], np.nan)
    beside = np.full(logs.shape, np.nan)
    for f, row in enumerate(logs):
        level = known_median(row)
        if np.isfinite(level):
            beside[f] = row - level
    for k, column in enumerate(beside.T):
        known = column[~np.isnan(column)]
        if known.size:
            found[k] = np.median(known) if np.isfinite(known).all() else -np.inf
    return found


def _left_out(problem: Problem, why: dict[int, str]) -> list[Finding]:
    """Return what is said of antennas (indices), which are left out unless they are too many."""
    numbers = problem.observation.antenna_numbers.tolist()
    few = len(why) < MOST_LEFT_OUT * len(numbers)
    found = []
    for ant, reason in sorted(why.items()):
        name, remedy = antenna_words(numbers[ant])
        left_out = (numbers[ant],) if few else ()
        found.append(Finding("a dead or absurd antenna", name, reason, remedy, antennas=left_out))
    return found
