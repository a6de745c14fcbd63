"""Whether cross-polarised visibilities show leakage between feeds: evidence, D-terms, and a check on held-out rows."""

from __future__ import annotations

from typing import Any

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.instrument.leakage import Leakage
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.loop.attribution.evidence import Evidence, find_evidence, log_evidence, solve
from hydrabeam_mpi.loop.checks.leakage_rows import CrossRows, LeakageSums, read_cross, sum_cross
from hydrabeam_mpi.loop.output.parameters import prior_scale
from hydrabeam_mpi.loop.output.sentences import say_parameter
from hydrabeam_mpi.loop.selection.heldout_score import HeldoutScore, gain_significance
from hydrabeam_mpi.mpi import ProcessGrid, allreduce_sum, bcast_object, together
from hydrabeam_mpi.setup.problem import Problem

EXPLAINED = 0.5
"""Part of the cross-polarised power beyond the noise that leakage must explain at least ..."""
CLEAR = 3.0
"""... where what it leaves is more than noise, by so many standard deviations."""
NAMED = 3
REFINED = 2
"""Times that co-polarised visibilities are freed from what has leaked into them, for D-terms of all orders."""


def check_leakage(grid: ProcessGrid, problem: Problem, setup: ObservingSetup) -> dict[str, Any] | None:
    """Look for leakage in the files' other polarisations. It changes nothing in the model of the co-polarised rows.

    Collective: all ranks of `grid.world`.

    Parameters
    ----------
    grid : ProcessGrid
    problem : Problem
        Of this group's channels.
    setup : ObservingSetup
        Of all channels.

    Returns
    -------
    dict or None
        None where there is no evidence of it. Where there is, an entry of the rounds. Otherwise ``effect`` and
        ``reason``: why it cannot be looked for, or, with ``log_bayes_factor``, why it was not accepted.
    """
    check = Leakage()
    not_applicable = check.not_applicable(setup)
    if not_applicable is not None:
        return {"effect": check.kind, "reason": not_applicable}
    try:
        with together(grid.world):
            train, test = (
                list(read_cross(check, grid, problem, setup, rows)) for rows in (problem.train, problem.test)
            )
    except InputError as error:
        return {"effect": check.kind, "reason": f"the other polarisations cannot be used: {error}"}
    settings = problem.job.loop
    for _ in range(1 + REFINED):
        sums, evidence = _weigh(grid, check, setup, train)
        if evidence.log_bayes_factor < settings.min_log_bayes_factor:
            return None
        train, test = ([one.without(check, setup, evidence.x[one.channel]) for one in rows] for rows in (train, test))
    before, after = _heldout(grid, problem, setup, test, evidence.x)
    held = sum_cross(grid, check, setup, test)
    # The predictive density of held-out rows is the evidence of all rows over that of the fitted ones.
    both = [one + two for one, two in zip(sums.blocks, held.blocks, strict=True)]
    ratio = log_evidence(both, evidence.prior_var) - log_evidence(sums.blocks, evidence.prior_var)
    sigma = gain_significance(before, after, ratio)
    reason = _reason(before, after, ratio, settings.min_log_bayes_factor)
    if reason is not None:
        return {"effect": check.kind, "log_bayes_factor": evidence.log_bayes_factor, "reason": reason}
    return _entry(check, setup, sums, evidence, (before.chi2, after.chi2, sigma))


def _weigh(
    grid: ProcessGrid, check: Leakage, setup: ObservingSetup, rows: list[CrossRows]
) -> tuple[LeakageSums, Evidence]:
    """Return the normal equations and what they say, on all ranks. Collective: all ranks of `grid.world`."""
    sums = sum_cross(grid, check, setup, rows)
    evidence = None
    with together(grid.world):
        if grid.is_world_root:
            evidence = find_evidence(sums.blocks, check.parameters(setup))
    told: Evidence = bcast_object(grid.world, evidence)
    return sums, told


def _heldout(
    grid: ProcessGrid, problem: Problem, setup: ObservingSetup, rows: list[CrossRows], x: FloatArray
) -> tuple[HeldoutScore, HeldoutScore]:
    """Sum w |r|^2 over held-out rows without and with leakage. Collective: all ranks of `grid.world`.

    Blocks are times only: an antenna at fault concerns few redundant groups, but all times.
    """
    times = np.zeros((3, setup.observation.Ntimes))
    with together(grid.world):
        tile = problem.tile_of(problem.test, grid.group.rank, grid.group.size)
        for part in rows:
            columns = Leakage().columns(setup, part.pol, part.bls, part.copols)
            left = part.data - columns.apply(x[part.channel])
            sums = part.weights * np.abs(part.data) ** 2, part.weights * np.abs(left) ** 2, part.weights > 0
            for total, values in zip(times, sums, strict=True):
                total[tile.times] += values.sum(axis=1)
    allreduce_sum(grid.world, times)
    before, after = (HeldoutScore(times[[k, 2]], np.zeros((2, 0))) for k in (0, 1))
    return before, after


def _reason(before: HeldoutScore, after: HeldoutScore, log_ratio: float, least: float) -> str | None:
    """Say why leakage is not accepted; None where it is."""
    if not before.n_data:
        return "no cross-polarised visibilities are held out that could confirm it"
    change = f"held-out reduced chi^2 of the cross-polarisations {before.chi2:.4g} -> {after.chi2:.4g}"
    if not log_ratio >= least:
        return f"{change}, and ln of their density changes by {log_ratio:.4g}"
    excess = after.chi2 - 1
    if excess * np.sqrt(after.n_data) > CLEAR and excess > (1 - EXPLAINED) * (before.chi2 - 1):
        return f"leakage explains too little of what they show: {change}"
    return None


def _entry(
    check: Leakage,
    setup: ObservingSetup,
    sums: LeakageSums,
    evidence: Evidence,
    heldout: tuple[float, float, float],
) -> dict[str, Any]:
    """Tell what was found, as an entry of the rounds."""
    n_data, power, noise, regressors = sums.scalars.sum(axis=0).tolist()
    told = _parameters(check, setup, sums, evidence)
    largest = sorted(told, key=lambda one: -abs(one["value"]) / one["std"])[:NAMED]
    before, after, sigma = heldout
    sentence = (
        f"{check.title.capitalize()}: {'; '.join(map(say_parameter, largest))}; of {len(told)} in all "
        f"(log Bayes factor {evidence.log_bayes_factor:,.0f}). It is seen in the cross-polarisations, whose held-out "
        f"reduced chi^2 goes {before:.3g} -> {after:.3g}, and left out of the model of the co-polarised data."
    )
    return {
        "effect": check.kind,
        "title": check.title,
        "sentence": sentence,
        "parameters": told,
        "log_bayes_factor": evidence.log_bayes_factor,
        "absorbed_by_beam": 0.0,
        "chi2_before": power / n_data,
        "chi2_after": (power - 0.5 * evidence.chi2_drop) / n_data,
        "heldout_before": before,
        "heldout_after": after,
        "heldout_sigma": sigma,
        "runner_up": None,
        "runner_up_log_bayes_factor": None,
        "indistinguishable_from": [],
        "beam_change_max": 0.0,
        "n_parameters": evidence.n_parameters,
        "effective_parameters": evidence.effective_parameters,
        "chi2_drop": evidence.chi2_drop,
        "rank": evidence.rank,
        "prior_scale": prior_scale(check.parameters(setup), evidence.prior_var),
        "attenuation": noise / regressors,
        "ranking": [],
        "residual": None,
    }


def _parameters(check: Leakage, setup: ObservingSetup, sums: LeakageSums, evidence: Evidence) -> list[dict[str, Any]]:
    """Return the D-terms in use with their posterior standard deviations, channel by channel."""
    names, used = check.parameters(setup).names, np.flatnonzero(evidence.prior_var)
    x, covariances = solve(sums.blocks, evidence.prior_var)
    return [
        {
            "name": names[i],
            "unit": "",
            "value": float(x[f, i]),
            "std": float(np.sqrt(covariances[f][i, i])),
            "freq_hz": float(freq),
        }
        for f, freq in enumerate(setup.observation.freqs)
        for i in used
    ]
