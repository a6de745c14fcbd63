"""Trials: what is weighed best is fitted, exactly and jointly, and the held-out rows are predicted with it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from hydrabeam_mpi.config.effects import Loop as LoopSettings
from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.error_scale import Left, left_of
from hydrabeam_mpi.fit.gauss_newton import BrokenOff, Worth
from hydrabeam_mpi.fit.grown import added_coefficients
from hydrabeam_mpi.fit.heldout import hold_prediction
from hydrabeam_mpi.fit.state import Fitted
from hydrabeam_mpi.loop.attribution.reconsider import reconsider_each
from hydrabeam_mpi.loop.rules import RULES
from hydrabeam_mpi.loop.selection.acceptance import (
    Candidate,
    Checked,
    Round,
    improvement,
    in_order,
    is_better,
    may_be_better,
    may_still_come_to,
)
from hydrabeam_mpi.loop.selection.candidate_fits import as_large_as_wanted, fit_candidate
from hydrabeam_mpi.loop.selection.folds import compared
from hydrabeam_mpi.loop.selection.freer_beam import refusal_by_freer_beam
from hydrabeam_mpi.loop.selection.refits import log_joint
from hydrabeam_mpi.loop.selection.refusal import refusal_beside, refusal_of, rivals_of
from hydrabeam_mpi.loop.selection.weighing import Outlook
from hydrabeam_mpi.result.summary import evaluate_on_grid
from hydrabeam_mpi.terminal.progress import say


def try_effects(
    context: FitContext,
    checked: Checked,
    ranking: Sequence[Candidate],
    tried: list[tuple[Candidate, str]],
    best: Round | None = None,
    outlook: Outlook | None = None,
) -> Round | None:
    """Fit the candidates that may be the best; return the best of those that held-out data confirm.

    Collective: all ranks of the grid. ``tried`` receives those that they do not confirm, with the reason; what is no
    better than another is not asked, as that takes as long as its fit. Where there is a ``best`` one already, which may
    stand for a set of effects, others have to be better. Where an ``outlook`` is given, it says which is tried first,
    and whether what the best so far leaves is explained by others, so that its rivals need not be tried.
    """
    settings, ranking = context.problem.job.loop, _grown(context, checked.fitted, ranking, best)
    wanted = [one for one in _wanted(context, checked.fitted, ranking) if not one.is_control]
    for candidate in in_order(wanted, RULES.most_tries, outlook.weighed.first if outlook else None):
        if best is not None and not may_be_tried(context, candidate, best, outlook):
            continue
        try:
            fitted, after = fit_candidate(context, checked, candidate, _worth(context, checked, candidate, best))
        except BrokenOff as why:
            say(f"    refused: {why}", context.grid.is_world_root)
            tried.append((candidate, str(why)))
            continue
        beside = None
        if best is not None and ((outlook and outlook.leads) or not is_better(fitted, after, best)):
            beside = outlook.leads_further(fitted, after, best) if outlook else None
            if beside is None:
                continue
            told = f"    with another beside it, it comes to more than {best.candidate.title} can with any"
            say(told, context.grid.is_world_root)
        elif best is not None and outlook and outlook.is_led_by(best, fitted, after):
            told = f"    with another beside it, {best.candidate.title} comes to more than it can with any"
            say(told, context.grid.is_world_root)
            continue
        reason = refusal_of_fit(context, checked, after, fitted)
        reason = reason or least_beside(context, after.fitted, {-1: rivals_of(fitted, ranking, settings)})[-1].refusal
        say(f"    refused: {reason}", context.grid.is_world_root and reason is not None)
        if reason is not None:
            tried.append((fitted, reason))
        else:
            best = round_of(context, checked, after, fitted, ranking)
            if outlook and beside:
                outlook.follow(best, beside)
            # Once it is the model this is asked for again.
            hold_prediction(context, after.fitted)
    return best


def _grown(
    context: FitContext, fitted: Fitted, ranking: Sequence[Candidate], best: Round | None
) -> tuple[Candidate, ...]:
    """Order candidates again once those that may come first are as large as is wanted. Collective: all ranks."""
    known = [one.log_bayes_factor for one in _wanted(context, fitted, ranking) if one.finding is not None]
    least = RULES.near * max([*known, best.candidate.of_fitted if best else 0.0], default=0.0)
    grown = [as_large_as_wanted(context, fitted, one) if one.log_bayes_factor > least else one for one in ranking]
    return tuple(sorted(grown, key=lambda one: -one.of_fitted))


def may_be_tried(context: FitContext, candidate: Candidate, best: Round, outlook: Outlook | None) -> bool:
    """Whether a candidate is worth a fit beside the best so far. Collective: all ranks of the grid."""
    leaves_nothing, members = best.after.remains.consistent, {one.name for one in best.together}
    # Laws in time of a constant effect are no rivals of it: they are looked for beside it, in every round.
    if candidate.name in members or (candidate.kind, Effect.law) in members:
        return False
    # Nor is one thing that changes a rival of one that stays as it is, if it promises no more than that has come to.
    # Where several stay it may stand for them all.
    if candidate.special_case == best.candidate.name and candidate.of_fitted <= best.candidate.of_fitted:
        last = best.after.fitted.values.active[-1]
        if len(np.unique(last.effect.parameters(context.setup).element[last.used])) == 1:
            return False
    if outlook is None or leaves_nothing or not may_be_better(candidate, best, leaves_nothing):
        return may_be_better(candidate, best, leaves_nothing)
    if candidate.is_of_unknown:
        # What an effect explains is not to be left out with what none does.
        left = outlook.beside(best, candidate)
        return bool(left > 0 and candidate.log_bayes_factor > best.evidence_of_all + left)
    if candidate.finding is None or not candidate.finding.effect.linear:
        return may_be_better(candidate, best, enough=True) or not outlook.explains_rest(best)
    # Of what is linear it is known what it comes to, and so whether that is more than the best with what is beside it.
    with_rest = outlook.with_rest(best)
    return with_rest is None or may_be_better(candidate, with_rest, enough=True)


def _worth(context: FitContext, before: Checked, candidate: Candidate, best: Round | None) -> Worth | None:
    """Return whether to go on with a candidate's fit, which may not come to more than the best one so far.

    Nor, where there is none, to as much as a job asks for.
    """
    if candidate.finding is None:
        return None
    settings, left = context.problem.job.loop, left_of(context, before.fitted)
    least = best.candidate.of_fitted if best else least_evidence(settings, left, candidate, is_in=False)
    nonlinear = bool(candidate.finding.effect.parameters(context.setup).nonlinear.any())
    start = log_joint(context, before.fitted)
    return lambda at: may_still_come_to(least, candidate, at, start, nonlinear)


def refusal_of_fit(
    context: FitContext, before: Checked, after: Checked, fitted: Candidate, whole: Fitted | None = None
) -> str | None:
    """Say why a fitted candidate is not kept; None where it is. Collective: all ranks of the grid.

    It is asked for evidence beside what it leaves of the data, or what a ``whole`` set leaves that it is one of.
    """
    settings, left = context.problem.job.loop, left_of(context, whole or after.fitted)
    least = least_evidence(settings, left, fitted, is_in=True)
    if fitted.finding is not None and fitted.log_bayes_factor >= least:
        one, two = compared(context, before, after)
        return refusal_of(one, two, fitted, settings) or refusal_by_freer_beam(context, before.fitted, after.fitted)
    return refusal_of(before, after, fitted, settings, least)


def least_evidence(settings: LoopSettings, left: Left, candidate: Candidate, is_in: bool) -> float:
    """Return the ln Bayes factor that a candidate must have: what the job asks for, in units of what is left with it.

    Bayes factors are by the noise that is stated. What is left beside an effect is of unknown origin, and counts as
    noise of unknown size does: the evidence of the effect is so many times less. So errors count it, see `error_scale`,
    and predictions, see `HeldoutScore.log_density_at_own_level`. What is left with a candidate the linear model says,
    unless the fit has it (``is_in``). A change of the weights makes it noise.
    """
    if candidate.finding is None:
        return settings.min_log_bayes_factor
    chi2_drop = 0.0 if is_in else candidate.finding.evidence.chi2_drop
    return settings.min_log_bayes_factor * left.over_noise(chi2_drop)


class BesideRivals(NamedTuple):
    """The least log Bayes factor that an effect has beside a rival, and why that is too little, if it is."""

    log_bayes_factor: float
    refusal: str | None


def least_beside(
    context: FitContext, fitted: Fitted, rivals: Mapping[int, Sequence[Candidate]]
) -> dict[int, BesideRivals]:
    """Weigh effects of the model, by their places in it, each beside its rivals. Collective: all ranks of the grid."""
    least = {place: BesideRivals(np.inf, None) for place in rivals}
    # Control models are several of one kind.
    every = {id(rival): rival for of_one in rivals.values() for rival in of_one}
    for rival in every.values():
        assert rival.finding is not None
        places = [place for place, of_one in rivals.items() if any(one is rival for one in of_one)]
        for place, left in zip(places, reconsider_each(context, fitted, places, rival.finding), strict=True):
            if left.log_bayes_factor < least[place].log_bayes_factor:
                reason = refusal_beside(rival, left.log_bayes_factor, context.problem.job.loop)
                least[place] = BesideRivals(left.log_bayes_factor, reason)
    return least


def try_control(
    context: FitContext, checked: Checked, ranking: Sequence[Candidate], found: Round | None
) -> Round | None:
    """Fit the control model with the most evidence where it may explain more than what was found.

    It is asked what effects are: one that the held-out data refuse explains nothing. Collective: all ranks of the grid.
    """
    controls = [one for one in _wanted(context, checked.fitted, ranking) if one.is_control]
    if not controls or (found is not None and not may_be_better(controls[0], found, found.after.remains.consistent)):
        return None
    try:
        fitted, after = fit_candidate(context, checked, controls[0])
    except BrokenOff:
        return None
    reason = refusal_of_fit(context, checked, after, fitted)
    say(f"    refused: {reason}", context.grid.is_world_root and reason is not None)
    return None if reason is not None else round_of(context, checked, after, fitted, ranking)


def _wanted(context: FitContext, fitted: Fitted, ranking: Sequence[Candidate]) -> list[Candidate]:
    """Return the candidates that have as much evidence as they must. Collective: all ranks of the grid."""
    settings, left = context.problem.job.loop, left_of(context, fitted)
    return [one for one in ranking if one.log_bayes_factor >= least_evidence(settings, left, one, is_in=False)]


def round_of(
    context: FitContext, before: Checked, after: Checked, fitted: Candidate, ranking: Sequence[Candidate]
) -> Round:
    """Tell what a fitted candidate changes. Collective: all ranks of the grid."""
    change = _beam_change(context, before.fitted, after.fitted)
    sigma, place = improvement(before, after, fitted), len(after.fitted.values.active) - 1
    return Round(fitted, tuple(ranking), before, after, sigma, change, place if fitted.finding else None)


def _beam_change(context: FitContext, before: Fitted, after: Fitted) -> float:
    """Return by how much the beam moved at most, on the one-degree grid and over channels."""
    basis, setup, largest = context.problem.basis, context.setup, 0.0
    for channel, one, two in zip(context.channels, before.fit.posteriors, after.fit.posteriors, strict=True):
        added = [added_coefficients(setup, fitted.values, channel) for fitted in (before, after)]
        moved: FloatArray = two.mean + added[1] - one.mean - added[0]

        def change(za: FloatArray, az: FloatArray, moved: FloatArray = moved) -> Any:
            return basis.synthesize(moved, za, az)

        largest = max(largest, float(np.abs(evaluate_on_grid(change)).max()))
    return float(max(context.grid.world.allgather(largest)))
