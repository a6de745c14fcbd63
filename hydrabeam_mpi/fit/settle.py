"""The last steps of a fit: to where it is the same whichever way it came there."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np

from hydrabeam_mpi.fit.acceleration import MEMORY, EarlierSteps, accelerated
from hydrabeam_mpi.fit.beams_given import Solved, diagnostics_of, solve_beams
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import BrokenOff, misfit_of, refit
from hydrabeam_mpi.fit.state import Active, Ended, Fitted
from hydrabeam_mpi.fit.step import beam_moved, take_step

SETTLED_SIGMAS = 1e-8
"""Nothing moves any more where no parameter does by more than this fraction of its standard deviation.

It is far above rounding, and far below the 1e-6 to which a written fit can be computed again.
"""
PATIENCE = MEMORY + 1
"""The fit is as still as it gets where so many steps in a row are longer than the shortest: one more than those that
the next one learns from."""
MAX_SETTLING = 60
"""Steps at most; nearly all fits take three to fifteen."""
SAME_PEAK_NATS = 1.0
"""What is lower than the fit by more than this in ln(likelihood x prior), over reduced chi^2 where that is above one,
is not where the fit leads: of one parameter that is 1.4 standard deviations.

A little lower it may be: E is taken as seen by the beams, which are solved for as if it did not change with them.
"""


def refined(fitted: Fitted, n_known: int = 0) -> Fitted:
    """Return the fit with effects as they are described by what has been fitted; see `Effect.refined`.

    The first ``n_known`` stay as they are: what is known of them beforehand is in terms of these.
    """
    active, stds = list(fitted.values.active[:n_known]), list(fitted.fit.std[:n_known])
    for one, std in zip(fitted.values.active[n_known:], fitted.fit.std[n_known:], strict=True):
        effect, x, left = one.effect.refined(one.x, one.used)
        used, limits, held = np.searchsorted(left, one.used), one.step_limit[left], one.degenerate_directions[:, left]
        active.append(Active(effect, used, one.prior, x, limits, held))
        stds.append(std[:, left])
    values = replace(fitted.values, active=tuple(active))
    return replace(fitted, values=values, fit=replace(fitted.fit, std=tuple(stds)))


def settle(context: FitContext, fitted: Fitted) -> Fitted:
    """Go on with a fit to where nothing moves at all, whichever way it came there. Collective: all ranks of the grid.

    What is written can then be computed again from the values that are written. A fit whose steps do not get shorter
    stays as it is.
    """
    if not fitted.values.active:
        return fitted
    if fitted.diagnostics.ended is Ended.FLAT:
        # It went no further than evidence tells. Where there are no beams further on it stays where it is.
        with suppress(BrokenOff):
            fitted = refit(context, fitted.values, fitted)
    at, earlier = fitted.estimate, EarlierSteps()
    shortest, lowest, waited = np.inf, -np.inf, 0
    stillest: tuple[Fitted, Solved] | None = None
    for number in range(MAX_SETTLING):
        solved = solve_beams(context, at)
        if number == 0:
            lowest = solved.reached - SAME_PEAK_NATS * misfit_of(context, solved)
        step = take_step(context, replace(at, beams=solved.beams), solved)
        moved = max(step.moved, beam_moved(context, at.beams, solved.beams))
        waited += 1
        if moved < shortest and solved.reached >= lowest:
            shortest, waited = moved, 0
            if number > 0:
                stillest = Fitted(at.values, step.fit.with_beams(solved.beams)), solved
        if moved < SETTLED_SIGMAS or waited == PATIENCE:
            break
        further = accelerated(context, at, solved.beams, step.to, step.fit, earlier)
        at = step.to if further is None else further
    if stillest is None:
        return fitted
    return replace(stillest[0], diagnostics=diagnostics_of(context, stillest[1]))
