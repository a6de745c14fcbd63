"""The health of data, before anything is fitted: flux scale, noise, antennas, times and baselines.

Nothing is inferred from data of which a dead antenna, a bad integration or a wrong flux scale has the most weight. Each
check compares the data with themselves and with the visibilities of the model beam, in fitted and held-out rows alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hydrabeam_mpi.loop.checks.bad_antennas import absurd_antennas, absurd_autocorrelations
from hydrabeam_mpi.loop.checks.bad_ends import by_antenna
from hydrabeam_mpi.loop.checks.bad_rows import bad_baselines, bad_times
from hydrabeam_mpi.loop.checks.conjugated import conjugated_baselines
from hydrabeam_mpi.loop.checks.exchanged import exchanged_antennas
from hydrabeam_mpi.loop.checks.filtered import filtered
from hydrabeam_mpi.loop.checks.health_sums import Excess, Kept, Sample, Sums, read_sample
from hydrabeam_mpi.loop.checks.partners import noise_beside_partners, noisy_baselines
from hydrabeam_mpi.loop.checks.scale import flux_scale, noise_level, noise_ratio
from hydrabeam_mpi.loop.checks.scaled_times import scaled_times
from hydrabeam_mpi.mpi import ProcessGrid, bcast_object, together
from hydrabeam_mpi.setup.findings import Finding, mended_job
from hydrabeam_mpi.setup.problem import Problem, estimate_noise, select_anew
from hydrabeam_mpi.terminal.progress import warn

MOST_LOOKS = 8
"""Looks at what is left when something has been put aside: each finds what the last one was hidden by."""


def check_health(grid: ProcessGrid, problem: Problem) -> list[Finding]:
    """Look for what no effect describes and nothing should be inferred from.

    Collective: all ranks of the grid.

    Parameters
    ----------
    grid : ProcessGrid
    problem : Problem
        Of all channels.

    Returns
    -------
    list of Finding
        The same on all ranks, whatever their number.
    """
    sample = read_sample(grid, problem)
    found = absurd_autocorrelations(grid, problem, sample)
    for _ in range(MOST_LOOKS):
        more, last = _look(grid, problem, sample, found)
        if not more:
            break
        found += more
    return by_antenna(problem, found) + last


def _look(
    grid: ProcessGrid, problem: Problem, sample: Sample, found: Sequence[Finding]
) -> tuple[list[Finding], list[Finding]]:
    """Look at what is not put aside yet: return what to put aside too, and what else there is to say."""
    kept = _without(problem, found)
    weights = kept.weights(sample, problem.observation.antenna_index)
    sums = Sums.of(grid, problem, sample, weights)
    antennas = absurd_antennas(problem, sums) or exchanged_antennas(grid, problem, sample, weights, sums.bl_products)
    if antennas:
        return antennas, []
    excess = Excess.of(grid, problem, sample, weights, sums)
    partners = Excess.of_partners(grid, problem, sample, weights)
    noise = noise_beside_partners(grid, problem, sample, weights)
    rows = (
        conjugated_baselines(grid, problem, sample, weights, sums)
        or bad_times(problem, sample.times, sums, excess)
        or bad_times(problem, sample.times, sums, partners)
        or scaled_times(problem, sample.times, sums, excess)
        or bad_baselines(problem, sums, excess)
        or noisy_baselines(problem, noise)
    )
    scale = flux_scale(problem, sums)
    ratio = noise_ratio(excess.noise, noise)
    # On another scale that noise is, too, which nothing tells but the job.
    is_known = ratio is not None or problem.job.noise.kind == "autocorrelations" or not scale
    filters = filtered(grid, problem, sample, weights, ratio or 1.0) if is_known and not rows else []
    # What a filter has left is of no size that tells a flux scale.
    return rows, [
        *(filters or scale),
        *noise_level(problem, excess.noise, noise),
        *_not_looked_for(excess, partners),
    ]


def _not_looked_for(excess: Excess, partners: Excess) -> list[Finding]:
    """Say so where integrations can be compared with nothing but the model beam, beside which only gross ones show."""
    if excess.differenced or partners.times.any():
        return []
    why = "times lie too far apart to be compared, and no two baselines are redundant"
    remedy = "after a fit `hydrabeam loop` looks for them again"
    what = "bad integrations show before a fit only where they are gross"
    return [Finding(what, "this array and these times", why, remedy, is_fault=False)]


def _without(problem: Problem, found: Sequence[Finding]) -> Kept:
    """Return what the findings put aside as indices."""
    observation = problem.observation
    numbers = [ant for one in found for ant in one.antennas]
    pairs = {frozenset(pair) for one in found for pair in one.baselines}
    spans = [span for one in found for span in one.times]
    return Kept(
        frozenset(np.flatnonzero(np.isin(observation.antenna_numbers, numbers)).tolist()),
        frozenset(k for k, jd in enumerate(observation.times) if any(a <= jd <= b for a, b in spans)),
        frozenset(k for k, pair in enumerate(observation.antpairs.tolist()) if frozenset(pair) in pairs),
    )


def told(grid: ProcessGrid, problem: Problem) -> Problem:
    """Return the problem with what is doubtful about its data among its cautions, and say it.

    Collective: all ranks of the grid.
    """
    findings = check_health(grid, problem)
    lines = tuple(one.line for one in findings)
    if grid.is_world_root:
        warn(lines)
    faults = tuple(one for one in findings if one.is_fault)
    return replace(problem, findings=faults, cautions=(*problem.cautions, *lines))


def mended(grid: ProcessGrid, problem: Problem) -> Problem:
    """Return the problem without what should not be inferred from, and in Jy; what was done is among its cautions.

    Collective: all ranks of the grid.
    """
    problem = told(grid, problem)
    if problem.job.effects:
        # They may be about the very antennas.
        return problem
    job = mended_job(problem.job, problem.findings)
    if job == problem.job:
        return problem
    anew = None
    with together(grid.world):
        if grid.is_world_root:
            anew = select_anew(problem, job)
    return estimate_noise(grid.world, bcast_object(grid.world, anew))
