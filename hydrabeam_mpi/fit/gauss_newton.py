"""The joint fit of beams and effects: Gauss-Newton steps until neither moves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.fit.acceleration import EarlierSteps, accelerated, followed
from hydrabeam_mpi.fit.beams_given import Solved, diagnostics_of, solve_beams
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.joint_step import solve_jointly
from hydrabeam_mpi.fit.own_beams import with_own_beams
from hydrabeam_mpi.fit.state import Ended, Estimate, Fit, Fitted, Values
from hydrabeam_mpi.fit.step import Step, beam_moved, step_of, take_step
from hydrabeam_mpi.mpi import bcast_object, together
from hydrabeam_mpi.terminal.progress import say_meanwhile

MAX_STEPS = 30
"""Most fits take three to eight; dozens of sources at once, of which some are not there, take twenty."""
SHORTER = 0.5
"""By which a step gets shorter that has led lower, and longer again where it has led higher."""
MAX_SHORTENED = 5
"""How often before the fit stops at the best point so far."""
STEP_SIGMAS = 0.03
"""Converged when no beam moves by more than this fraction of its standard deviation, rms over coefficients.

Standard deviations are those by the stated noise; where reduced chi^2 is above one they are scaled by its root.
"""
FLAT_NATS = 0.01
"""A smaller rise of ln(likelihood x prior), over reduced chi^2 where that is above one, counts as none.

Parameters that still move then drift along directions that the data do not constrain.
"""
NEARLY_FLAT_NATS = 0.1
"""The same where a fit is to tell evidence alone, and where no part of a step leads higher: evidence tells no less."""
FLAT_STEPS = 2
"""The fit ends after this many steps in a row without a rise."""
KEPT = 3
"""Of so many steps the one that kept most of what the linear model promised says how much the next may keep. One that
was too long keeps little, and the shorter one after it, or the one beyond that, may keep all."""
STEPS_BACK = 0.5
"""A step counts as too long at this relative loss of ln(likelihood x prior), where all weights follow residuals."""


@dataclass(frozen=True)
class Underway:
    """Where a fit has come to.

    Attributes
    ----------
    reached : float
        ln(likelihood x prior).
    expected : float
        By how much the next step may raise it: as the linear model expects, as far as steps before have kept that.
    foreseen : tuple of float
        What the linear model expects of the end, by where the fit began and by where it is.
    price : float, optional
        What the freedom of its parameters costs, where that is known of this fit.
    """

    reached: float
    expected: float
    foreseen: tuple[float, float]
    price: float | None = None


Worth = Callable[[Underway], bool]
"""Whether a fit is worth going on with."""
NOT_NEAR = "its fit was broken off, as it does not come near what it would have to explain"
"""Why a fit has no end: it is not worth going on with."""
NO_BEAMS = "its fit was broken off, as no beams can be solved for where it begins or leads"
"""Why a fit has no end: with such effects next to nothing of the data is left that tells of a beam."""


class BrokenOff(Exception):
    """A fit is not worth going on with, for the reason that the message says."""


def refit(
    context: FitContext,
    values: Values,
    before: Fitted | None = None,
    first_step: float = 1.0,
    worth: Worth | None = None,
    for_evidence: bool = False,
    within: float = STEP_SIGMAS,
) -> Fitted:
    """Fit beams and effects jointly, beginning with the effects' ``values``.

    Collective: all ranks of the grid. Given the effects the beams are solved for exactly; given the beams, the effects
    take a Gauss-Newton step in which the beams follow (the Schur complement). That step does not know how E changes
    with the beams, which may be a lot; so E is computed with the beams as they have followed, and the step is shortened
    until beams and effects together are likelier than before. Where no part of it is, the fit ends where it was best,
    and `Diagnostics.converged` says so.

    Parameters
    ----------
    context : FitContext
    values : Values
    before : Fitted, optional
        A fit of the first of these effects, whose beams are where this one begins.
    first_step : float
        Which part of the first step is taken; later ones are twice as long while they succeed, up to whole ones. If it
        is not all of it, parts of steps are damped ones.
    worth : callable, optional
        Says after each step whether to go on.
    for_evidence : bool
        Whether the fit is to tell evidence alone, and ends where that rises by next to nothing.
    within : float
        Standard deviations by which beams may still move when it has converged; see `STEP_SIGMAS`.

    Raises
    ------
    BrokenOff
        On all ranks, where it is not worth it, or no beams can be solved for with the effects as they are at first or
        in the end.
    """
    start = _start(values, before)
    if not values.active and not values.reweighted:
        solved = solve_beams(context, start)
        return Fitted(values, Fit(solved.beams), diagnostics_of(context, solved))
    try:
        if before is None or len(values.active) < len(before.fit.std):
            # Those before are none, or belong to effects that have been left out.
            start = with_own_beams(context, start, MAX_STEPS, STEP_SIGMAS)
        end, step, ended = _search(context, start, first_step, worth, for_evidence, within)
        end = replace(end, values=end.values.without_turns(context.setup))
        # Not converged: the beams that E is seen by stay, as E may be another one with those solved for.
        solved = solve_beams(context, end, keep=ended is not Ended.CONVERGED and end.values.adds)
    except InputError as error:
        if before is None:
            raise
        raise BrokenOff(NO_BEAMS) from error
    diagnostics = replace(diagnostics_of(context, solved), ended=ended)
    return Fitted(end.values, step.fit.with_beams(solved.beams), diagnostics)


def stepped(context: FitContext, values: Values, before: Fitted) -> Fitted:
    """Take one step from the effects' ``values``, near their linear optimum. Collective: all ranks of the grid.

    Raises
    ------
    BrokenOff
        On all ranks, where no beams can be solved for there.
    """
    at = Estimate(values, before.fit.posteriors)
    try:
        solved = solve_beams(context, at)
    except InputError as error:
        raise BrokenOff(NO_BEAMS) from error
    step = take_step(context, replace(at, beams=solved.beams), solved)
    return Fitted(step.to.values, step.fit.with_beams(step.to.beams), diagnostics_of(context, solved))


def _start(values: Values, before: Fitted | None) -> Estimate:
    """Begin from zero where E was never fitted: how large it may be depends on how the beams give way.

    Without a fit ``before``, values are those of a job, which were.
    """
    n_fitted = len(before.fit.std) if before else len(values.active)
    active = [
        replace(one, x=np.zeros_like(one.x)) if one.adds and number >= n_fitted else one
        for number, one in enumerate(values.active)
    ]
    return Estimate(replace(values, active=tuple(active)), before.fit.posteriors if before else ())


def _search(
    context: FitContext, at: Estimate, length: float, worth: Worth | None, for_evidence: bool, within: float
) -> tuple[Estimate, Step, Ended]:
    """Take steps until nothing moves; return where they end, the last of them, and why it is the last.

    ``length`` is that of the first one, of which it is a part; for the others see `refit`.
    """
    is_damped = length < 1.0
    best: tuple[float, Estimate, Step] | None = None
    ended = Ended.OUT_OF_STEPS
    flat = shortened = 0
    earlier, is_accelerated = EarlierSteps(), False
    promised, ahead, misfit, kept, foreseen = 0.0, np.inf, 1.0, list[float](), list[float]()
    length *= SHORTER
    for number in range(MAX_STEPS):
        say_meanwhile(f"    fitting: step {number + 1} of {MAX_STEPS} at most", context.grid.is_world_root)
        solved = _solved_or_too_far(context, at, best is None)
        if solved is not None and _is_too_long(context, best, at, solved):
            at, solved = _with_linear(context, at, solved)
        if best is not None and _is_too_long(context, best, at, solved):
            if is_accelerated:
                earlier.forget()
                at, is_accelerated = _part_of(context, best[1], best[2], length, is_damped), False
                continue
            if shortened == MAX_SHORTENED:
                ended = Ended.STUCK if ahead > NEARLY_FLAT_NATS * misfit else Ended.FLAT
                break
            shortened, length = shortened + 1, SHORTER * length
            promised = best[2].gain * length * (2 - length)
            at = _part_of(context, best[1], best[2], length, is_damped)
            continue
        assert solved is not None
        misfit, rise = misfit_of(context, solved), np.inf if best is None else solved.reached - best[0]
        flat = flat + 1 if rise < (NEARLY_FLAT_NATS if for_evidence else FLAT_NATS) * misfit else 0
        kept.append(float(np.clip(rise / promised, 0.0, 1.0)) if promised > 0 else 1.0)
        step = take_step(context, replace(at, beams=solved.beams), solved)
        ahead = solved.rises + step.gain
        foreseen.append(solved.reached + ahead)
        underway = Underway(solved.reached, max(kept[-KEPT:]) * ahead, (foreseen[0], foreseen[-1]))
        if worth is not None and not worth(underway):
            raise BrokenOff(NOT_NEAR)
        best = (solved.reached, at if at.values.adds else replace(at, beams=solved.beams), step)
        still = beam_moved(context, at.beams, solved.beams) < within * np.sqrt(misfit)
        # What is left to gain goes with the square of how far it is.
        still = still and step.gain < FLAT_NATS * (within / STEP_SIGMAS) ** 2 * misfit
        if still or (flat == FLAT_STEPS and not for_evidence):
            return step.to, step, Ended.CONVERGED
        if flat == FLAT_STEPS:
            ended = Ended.FLAT
            break
        # What was too long just before would be so again.
        length, shortened = length if shortened else min(1.0, length / SHORTER), 0
        further = None
        if length == 1.0:
            further = accelerated(context, at, solved.beams, step.to, step.fit, earlier)
        promised = step.gain * length * (2 - length)
        is_accelerated, at = further is not None, further or _part_of(context, best[1], step, length, is_damped)
    assert best is not None
    return best[1], best[2], ended


def _part_of(context: FitContext, at: Estimate, step: Step, length: float, is_damped: bool) -> Estimate:
    """Return where a part of a step from an estimate leads, or a damped step. Collective: all ranks of the grid.

    A part leads where the step does, which is best where parameters are hardly told from each other; a damped one turns
    to where the likelihood rises most (Levenberg and Marquardt). What effects add is seen by the beams, which then go
    but a part of the way to where the step's lead, too.
    """
    if length == 1.0:
        return step.to
    values, x = step.start.values, None
    if not is_damped or context.problem.coupling is not None or not values.active:
        return at.towards(step.to, length)
    with together(context.grid.world):
        if step.likelihoods is not None:
            x = solve_jointly(values, step.likelihoods, 1 / length - 1)[0]
    x = bcast_object(context.grid.world, x)
    beams = followed(context, step.start.beams, step.fit.beam_response, x - values.x)
    damped = Estimate(values.at(x), beams)
    return at.towards(damped, length) if values.adds else damped


def _with_linear(context: FitContext, at: Estimate, solved: Solved) -> tuple[Estimate, Solved]:
    """Solve for beams and linear effects together, with all others where they are, where that is likelier.

    What a beam lacks is seen by the sky: functions of the beam and a sky that changes are factors of each other, and
    after a long step of both neither is the best for the other. Collective: all ranks of the grid.
    """
    values = at.values
    which = [place for place, one in enumerate(values.active) if one.effect.linear and one.adds]
    if not which or len(which) == len(values.active) or context.problem.coupling is not None:
        return at, solved
    linear = replace(values, active=tuple(values.active[place] for place in which))
    step = step_of(context, replace(at, beams=solved.beams), solved, linear)
    active = list(values.active)
    for place, one in zip(which, step.to.values.active, strict=True):
        active[place] = one
    there = Estimate(replace(values, active=tuple(active)), step.to.beams)
    again = _solved_or_too_far(context, there, first=False)
    return (there, again) if again is not None and again.reached > solved.reached else (at, solved)


def _solved_or_too_far(context: FitContext, at: Estimate, first: bool) -> Solved | None:
    """Solve for the beams; None where the effects have gone so far that none can be solved for.

    At the ``first`` values that is an error. Collective: all ranks of the grid.
    """
    try:
        return solve_beams(context, at)
    except InputError:
        if first:
            raise
        return None


def _is_too_long(
    context: FitContext, best: tuple[float, Estimate, Step] | None, at: Estimate, solved: Solved | None
) -> bool:
    """Tell whether a step has led lower than the best so far. Collective: all ranks of the grid."""
    if best is None or solved is None:
        return solved is None
    return solved.reached - best[0] < _least_rise(best[0], at.values, misfit_of(context, solved))


def misfit_of(context: FitContext, solved: Solved) -> float:
    """Return the mean reduced chi^2 of the channels, at least one. Collective: all ranks of the grid."""
    return max(1.0, context.over_channels(solved.train_chi2) / context.setup.observation.Nfreqs)


def _least_rise(best: float, values: Values, misfit: float) -> float:
    """Return the rise of ln(likelihood x prior) below which a step was too long.

    When all weights change the likelihoods are not comparable, so that only a great loss counts.
    """
    incomparable = any(one.change.follows_residuals for one in values.reweighted)
    return -STEPS_BACK * abs(best) if incomparable else -FLAT_NATS * misfit
