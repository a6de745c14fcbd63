"""Data that were filtered in time or in frequency before they were given: no model's visibilities are.

A mean of each baseline over the night that was subtracted, fringe rates that were notched out as cross-talk, delays
that were taken away as foregrounds: what is missing then would be taken for emission, couplings and closure errors.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hydrabeam_mpi.config import Job
from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.effects.shared.nightly_laws import Sidereal
from hydrabeam_mpi.loop.checks.health_sums import PER_DAY, Sample
from hydrabeam_mpi.loop.checks.slow_modes import Lacking, Series, lacking_modes
from hydrabeam_mpi.mpi import ProcessGrid, allreduce_sum
from hydrabeam_mpi.setup.findings import Finding
from hydrabeam_mpi.setup.problem import Problem

CONSTANTS = "cross_coupling"
"""The effect that a mean is, which was subtracted from each baseline."""
NOTHING = 1e-6
"""Of the noise's power: what is less is told as this, as rounding decides."""


def filtered(
    grid: ProcessGrid, problem: Problem, sample: Sample, weights: FloatArray, noise_ratio: float
) -> list[Finding]:
    """Find out whether slow modes in time or in frequency lack more than sky: their noise.

    Collective: all ranks of the grid.

    Parameters
    ----------
    grid : ProcessGrid
    problem : Problem
        Of all channels.
    sample : Sample
    weights : ndarray, (Nlocal, Ntimes, Nbls)
        Of what counts of it.
    noise_ratio : float
        Power of the noise that differences show over the one that is stated.
    """
    level = min(1.0, noise_ratio, _mean_power(grid, sample, weights))
    if level <= 0:
        return []
    found = [_in_time(grid, problem, sample, weights, level), _in_frequency(grid, problem, sample, weights, level)]
    return [one for one in found if one is not None]


def _mean_power(grid: ProcessGrid, sample: Sample, weights: FloatArray) -> float:
    """Return the mean power of all data over that of the noise: if it is less than one, the noise is overstated."""
    sums = np.array([np.sum(weights * np.abs(sample.data) ** 2), float(np.count_nonzero(weights))])
    allreduce_sum(grid.world, sums)
    return float(sums[0] / sums[1]) if sums[1] else 0.0


def _in_time(grid: ProcessGrid, problem: Problem, sample: Sample, weights: FloatArray, level: float) -> Finding | None:
    """Look at all times at once and, where there are several, at each night by itself."""
    times = problem.observation.times[sample.times]
    night = Sidereal().over(times).nights_of(times)
    nights = np.unique(night)
    parts = [[night >= 0]] if len(nights) == 1 else [[night == one for one in nights], [night >= night.min()]]
    looks = []
    for chosen in parts:
        of_each = [
            Series.of(times[some], *(_along_time(one[:, some]) for one in (sample.data, sample.model, weights)))
            for some in chosen
        ]
        looks.append(_most(grid, of_each, level))
    best = max((one for one in looks if one), key=lambda one: one.n_modes, default=None)
    if best is None:
        return None
    each_night = len(parts) == 2 and best is looks[0]
    seconds = _length(times * PER_DAY) if not each_night else max(_length(times[some] * PER_DAY) for some in parts[0])
    only_mean = best.among == 1 and not each_night
    if only_mean and any(one.kind == CONSTANTS for one in problem.job.effects):
        return None
    where = "each night of each baseline" if each_night else "each baseline"
    rates = f"fringe rates below about {_rounded(1e3 * best.n_modes / (2 * seconds))} mHz"
    what = "its mean over the times" if best.among == 1 else f"what varies slowest of it ({_modes(best)}: {rates})"
    finding = _finding("time", where, what, best)
    return _with_constants(problem.job, finding) if only_mean else finding


def _along_time(values: Array) -> Array:
    """Return samples (Nfreqs, Ntimes, Nbls) as series, (Ntimes, Nfreqs * Nbls)."""
    return np.moveaxis(values, 1, 0).reshape(values.shape[1], -1)


def _in_frequency(
    grid: ProcessGrid, problem: Problem, sample: Sample, weights: FloatArray, level: float
) -> Finding | None:
    """Look at all channels of each baseline and time."""
    freqs = problem.observation.freqs
    if len(freqs) < 2:
        return None
    parts = _whole_bands(grid, sample, weights)
    best = _most(grid, [Series.of(freqs, *(one.reshape(len(freqs), -1) for one in parts))], level)
    if best is None:
        return None
    delays = f"delays below about {_rounded(1e9 * best.n_modes / (2 * _length(freqs)))} ns"
    what = "its mean over the channels" if best.among == 1 else f"what is smoothest of it ({_modes(best)}: {delays})"
    return _finding("frequency", "each baseline and time", what, best)


def _whole_bands(grid: ProcessGrid, sample: Sample, weights: FloatArray) -> list[Array]:
    """Return data, model and weights of all channels of a rank's share of the baselines, (Nfreqs, Ntimes, Nown).

    Collective: all ranks of the grid. A sample is thinned to what may be sent at once.
    """
    parts: list[Array] = [sample.data, sample.model, weights]
    if grid.n_groups == 1:
        return parts
    chosen = [np.flatnonzero(sample.bls % grid.world.size == rank) for rank in range(grid.world.size)]
    pieces = [(sample.channels, sample.bls[mine], [one[..., mine] for one in parts]) for mine in chosen]
    received = grid.world.alltoall(pieces)
    own = np.unique(np.concatenate([bls for _, bls, _ in received]))
    whole: list[Array] = [np.zeros((grid.n_channels, len(sample.times), len(own)), one.dtype) for one in parts]
    for channels, bls, values in received:
        for target, one in zip(whole, values, strict=True):
            target[np.ix_(channels, np.arange(len(sample.times)), np.searchsorted(own, bls))] = one
    return whole


def _most(grid: ProcessGrid, series: list[Series], level: float) -> Lacking | None:
    """Return what most is lacking of, where samples count alike or by their weights."""
    looks = [
        lacking_modes(grid.world, series, level),
        lacking_modes(grid.world, [one.weighted() for one in series], level),
    ]
    return max((one for one in looks if one), key=lambda one: one.n_modes, default=None)


def _length(places: FloatArray) -> float:
    """Return what times or channels cover, half a step at both ends included."""
    return float(np.ptp(places)) * len(places) / max(len(places) - 1, 1)


def _modes(best: Lacking) -> str:
    return f"at least {best.n_modes} mode{'s' if best.n_modes > 1 else ''}"


def _rounded(value: float) -> str:
    return f"{float(f'{value:.2g}'):,.10g}"


def _finding(axis: str, where: str, what: str, best: Lacking) -> Finding:
    power = f"{best.power:.2g} times" if best.power > NOTHING else f"less than {NOTHING:g} times"
    why = (
        f"{what} holds {power} the noise's power, where the model beam's visibilities have {_rounded(best.model)} "
        "times; no sky and no instrument, but a filter takes away noise as well"
    )
    remedy = "use data from before the filter"
    return Finding(f"data filtered in {axis}", where, why, remedy, convention=f"filtered in {axis}")


def _with_constants(job: Job, finding: Finding) -> Finding:
    """Return the finding of a mean that was subtracted over all times, which constants of baselines make up for.

    Who asks for these alone gets them; among all effects others would take up part of it.
    """
    remedy = f"{finding.remedy}, or, as only a mean is gone, have it fitted: effects = [{CONSTANTS!r}] in [loop]"
    asked = CONSTANTS in (job.loop.effects or ())
    return replace(finding, remedy=remedy, convention="" if asked else finding.convention)
