"""One Gauss-Newton step of the effects, in which the beams follow, and how far it goes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hydrabeam_mpi.fit.acceleration import followed
from hydrabeam_mpi.fit.beams_given import Solved, diagnostics_of, solve_beams
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.coupled_step import share_step, step_together
from hydrabeam_mpi.fit.joint_step import solve_jointly
from hydrabeam_mpi.fit.linearised import linearised, sums_at
from hydrabeam_mpi.fit.state import Ended, Estimate, Fit, Fitted, Values
from hydrabeam_mpi.inference.likelihood import Likelihood
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.mpi import bcast_object, together


@dataclass(frozen=True)
class Step:
    """A Gauss-Newton step: where it leads, what it tells of the effects, and how many standard deviations it is long.

    Its ``fit`` is without posteriors, unless channels hang together. By ``gain`` the linear model expects
    ln(likelihood x prior) to rise. It begins at ``start``, by what is known on the grid's root of the ``likelihoods``
    there, unless channels hang together.
    """

    to: Estimate
    fit: Fit
    moved: float
    gain: float
    start: Estimate
    likelihoods: list[Likelihood] | None = None


def take_step(context: FitContext, at: Estimate, solved: Solved) -> Step:
    """Move the effects, with the beams ``at`` following them. Collective: all ranks of the grid."""
    values = at.values
    if not values.active:
        return Step(at, Fit(), 0.0, 0.0, at)
    if context.problem.coupling is not None:
        return _take_step_together(context, at, solved)
    return step_of(context, at, solved, values)


def step_of(context: FitContext, at: Estimate, solved: Solved, values: Values) -> Step:
    """Move some effects of the model, those of ``values``; it leads to these alone. Collective: all ranks."""
    likelihoods, response = linearised(context, at, solved, values)
    answer = None
    with together(context.grid.world):
        if likelihoods is not None:
            answer = solve_jointly(values, likelihoods)
    x, std, covariances, moved, gain = bcast_object(context.grid.world, answer)
    # E of the next step is seen by the beams that belong to these parameters, not by those before.
    beams = followed(context, at.beams, response, x - values.x)
    fit = Fit((), tuple(covariances[f] for f in context.channels), tuple(response), values.by_effect(std))
    return Step(Estimate(values.at(x), beams), fit, float(moved), float(gain), at, likelihoods)


def _take_step_together(context: FitContext, at: Estimate, solved: Solved) -> Step:
    """Take a step where beams hang together over frequency. Collective: all ranks of the grid."""
    values = at.values
    sums = list(sums_at(context, at, solved.rows, solved.added, values))
    step = step_together(context, values, sums, solved.together)
    beams, covariances, responses = share_step(context, step, solved.together, at.beams, values.x)
    told = bcast_object(context.grid.world, (step.x, step.std, step.moved, step.gain) if step else None)
    x, std, moved, gain = told
    fit = Fit(beams, covariances, responses, values.by_effect(std))
    return Step(Estimate(values.at(x), beams), fit, moved, gain, at)


def solved_at(context: FitContext, values: Values, before: Fitted, keep: bool = False) -> Fitted:
    """Solve for the beams alone, with the effects at ``values``; with ``keep`` the beams stay as they were.

    These are not the likeliest then, and the fit counts as one that has not converged. Collective: all ranks of the
    grid.
    """
    at = Estimate(values, before.fit.posteriors)
    solved = solve_beams(context, at, keep)
    step = take_step(context, replace(at, beams=solved.beams), solved)
    diagnostics = diagnostics_of(context, solved)
    if keep:
        diagnostics = replace(diagnostics, ended=Ended.STUCK)
    return Fitted(values, step.fit.with_beams(solved.beams), diagnostics)


def beam_moved(context: FitContext, before: Sequence[Posterior], after: Sequence[Posterior]) -> float:
    """Return the largest move of a channel's beam, rms over coefficients in standard deviations."""
    moved = 0.0 if len(before) == len(after) else np.inf
    for old, new in zip(before, after, strict=False):
        change = new.factor.conj().T @ (new.mean - old.mean)
        moved = max(moved, float(np.sqrt(np.mean(np.abs(change) ** 2))))
    return float(np.max(context.grid.world.allgather(moved)))
