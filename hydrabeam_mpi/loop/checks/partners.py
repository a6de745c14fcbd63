"""Baselines that are noisier than their redundant partners, whatever factors and constants they differ by."""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.inference.robust import LOG_MEAN, LOG_STD, MOST_EXCEPTIONS, known_median, outliers
from hydrabeam_mpi.io.noise import amid_neighbours
from hydrabeam_mpi.loop.checks.health_sums import PER_DAY, SECOND, Sample, second_differences
from hydrabeam_mpi.loop.checks.partner_means import partner_means
from hydrabeam_mpi.mpi import ProcessGrid, allreduce_sum
from hydrabeam_mpi.setup.findings import Finding, baseline_words
from hydrabeam_mpi.setup.problem import Problem

LEAST_PARTNERS = 2
"""Of two that differ nobody knows which is wrong."""
MOST_PASSES = 8
"""Times that a baseline's noise is worked out with what it came to before, until that moves by less than a per cent:
three where it is 16 times as large as stated, six where it is 100 times."""


def noisy_baselines(problem: Problem, noise: FloatArray) -> list[Finding]:
    """Find baselines that are noisier than the others, by what `noise_beside_partners` says.

    A baseline's noise is in the mean of its partners' as well: only the worst of a redundant group is named, and the
    others are looked at again without it.
    """
    total, n = noise
    logs = np.where(n > 0, total / np.maximum(n, 1), np.nan)
    # Differences that share a time are worth half as many.
    absurd = outliers(logs, LOG_STD / np.sqrt(np.maximum(n / 2, 1)))
    found, group = [], problem.redundant.group
    for b in np.flatnonzero(absurd > 0).tolist():
        if logs[b] == np.nanmax(logs[group == group[b]]):
            one, two = (int(ant) for ant in problem.observation.antpairs[b])
            name, remedy = baseline_words(one, two)
            ratio = np.exp(logs[b] - known_median(logs))
            why = (
                f"beside its redundant partners it has {ratio:.2g} times the others' noise, beyond a factor and a "
                f"constant ({absurd[b]:.0f} sigma)"
            )
            found.append(Finding("a bad baseline", name, why, remedy, baselines=((one, two),)))
    return found if len(found) <= MOST_EXCEPTIONS * np.count_nonzero(n) else []


def noise_beside_partners(grid: ProcessGrid, problem: Problem, sample: Sample, weights: FloatArray) -> FloatArray:
    """Compare baselines with the mean of their redundant partners. Collective: all ranks of the grid.

    Gains make a factor, couplings a constant: both are taken off, and whatever else an effect does to the sky is as
    smooth in time as the sky itself. What is left of second differences in time beyond that is noise. It needs
    neighbouring times, and three redundant baselines, but no model.

    Parameters
    ----------
    grid : ProcessGrid
    problem : Problem
        Of all channels.
    sample : Sample
    weights : ndarray, (Nlocal, Ntimes, Nbls)
        Of what counts of it.

    Returns
    -------
    ndarray, (2, Nbls)
        Sums and numbers of logs of power over that of the noise; zero where nobody can tell.
    """
    observation, logs = problem.observation, np.zeros((2, problem.observation.Nbls))
    middle = amid_neighbours(observation.times[sample.times] * PER_DAY, observation.integration_time[sample.times])
    if 2 * len(middle) < len(sample.times):
        return logs
    group = problem.redundant.group[sample.bls]
    for one in partner_means(group, sample.data, weights, LEAST_PARTNERS):
        left, factor = _beyond_factor_and_constant(one.data, one.mean, np.where(one.known, 1 / one.variance, 0.0))
        variance = one.variance + np.abs(factor) ** 2 * one.variance_of_mean
        logs[:, sample.bls] += _logs_of_noise(left, one.mean, np.where(one.known, variance, np.inf), middle)
    allreduce_sum(grid.world, logs)
    return logs


def _beyond_factor_and_constant(
    data: ComplexArray, mean: ComplexArray, weights: FloatArray
) -> tuple[ComplexArray, ComplexArray]:
    """Return d - g m - c with g and c best at all times for each baseline, (Ntimes, Nbls), and g, (Nbls,)."""
    total = weights.sum(axis=0)
    total = np.where(total > 0, total, 1.0)
    data, mean = (values - np.sum(weights * values, axis=0) / total for values in (data, mean))
    power = np.sum(weights * np.abs(mean) ** 2, axis=0)
    factor = np.where(power > 0, np.sum(weights * mean.conj() * data, axis=0) / np.where(power > 0, power, 1.0), 0.0)
    return np.where(weights > 0, data - factor * mean, 0.0), factor


def _logs_of_noise(left: ComplexArray, mean: ComplexArray, variance: FloatArray, middle: IntArray) -> FloatArray:
    """Return sums and numbers of logs of the power of second differences over that of the noise, (2, Nbls).

    What a baseline has beyond its noise may be an error of the factor, which moves as the ``mean`` does. How much that
    is depends on how large the noise is, which is what is looked for: each baseline's is taken as large as that.
    """
    power, moves = (np.abs(second_differences(one[np.newaxis], middle, SECOND)[0]) ** 2 for one in (left, mean))
    of_noise = second_differences(variance[np.newaxis], middle, SECOND**2)[0]
    told = np.isfinite(of_noise) & (power > 0)
    n, seen = told.sum(axis=0), np.sum(np.abs(mean) ** 2, axis=0)
    total, stated = np.sum(np.abs(left) ** 2, axis=0), np.sum(np.where(np.isfinite(variance), variance, 0.0), axis=0)
    logs, size = np.zeros(len(n)), np.ones(len(n))
    for _ in range(MOST_PASSES):
        beyond = np.maximum(total - size * stated, 0.0) / np.where(seen > 0, seen, 1.0)
        expected = np.where(told, of_noise, 1.0) + moves * beyond / size
        logs = np.sum(np.where(told, np.log(np.where(told, power, 1.0) / expected) - LOG_MEAN, 0.0), axis=0)
        size = np.exp(logs / np.maximum(n, 1))
    return np.stack([logs, n])
