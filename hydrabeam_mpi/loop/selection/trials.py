"""Trials: what is weighed best is fitted, exactly and jointly, and the held-out rows are predicted with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.interface.reweighting import ReweightingFit
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import BrokenOff, Worth, refit, stepped
from hydrabeam_mpi.fit.heldout import whiten
from hydrabeam_mpi.fit.state import Active, Fitted, Reweighted, Values
from hydrabeam_mpi.loop.attribution.reconsider import reconsider
from hydrabeam_mpi.loop.attribution.score_effects import Finding, attribute
from hydrabeam_mpi.loop.attribution.score_noise import refit_reweighting
from hydrabeam_mpi.loop.residuals.remains import remains_of
from hydrabeam_mpi.loop.rules import RULES
from hydrabeam_mpi.loop.selection.acceptance import (
    Candidate,
    Checked,
    Round,
    improvement,
    in_order,
    is_better,
    may_be_better,
    may_still_be_better,
)
from hydrabeam_mpi.loop.selection.heldout_numbers import heldout_numbers
from hydrabeam_mpi.loop.selection.heldout_score import heldout_score
from hydrabeam_mpi.loop.selection.physical import leave_out_unphysical, may_be_unphysical
from hydrabeam_mpi.loop.selection.refits import fit_patiently, is_same_prior, log_joint, restarted, rise
from hydrabeam_mpi.loop.selection.refusal import refusal_beside, refusal_of, rivals_of
from hydrabeam_mpi.loop.selection.weighing import Outlook
from hydrabeam_mpi.result.summary import evaluate_on_grid
from hydrabeam_mpi.terminal.progress import say


def check(context: FitContext, fitted: Fitted) -> Checked:
    """Predict the held-out rows. Collective: all ranks of the grid."""
    whitened = whiten(context, fitted)
    remains = remains_of(context, fitted, whitened)
    score = heldout_score(context, whitened, fitted.values)
    return Checked(fitted, score, remains, heldout_numbers(context, whitened))


def try_effects(
    context: FitContext,
    checked: Checked,
    ranking: Sequence[Candidate],
    tried: list[tuple[Candidate, str]],
    best: Round | None = None,
    outlook: Outlook | None = None,
) -> Round | None:
    """Fit the candidates that may be the best; return the best of those that held-out data confirm.

    Collective: all ranks of the grid. ``tried`` receives those that they do not confirm, with the reason. Where there
    is a ``best`` one already, others have to be better. Where an ``outlook`` is given, it says which is tried first,
    and whether what the best so far leaves is explained by others, so that its rivals need not be tried.
    """
    settings, better = context.problem.job.loop, outlook.is_better if outlook else is_better
    wanted = [one for one in _wanted(context, ranking) if not one.is_control]
    for candidate in in_order(wanted, RULES.most_tries, outlook.weighed.first if outlook else None):
        if best is not None and not _may_be_better(candidate, best, outlook):
            continue
        try:
            candidate = as_large_as_wanted(context, checked.fitted, candidate)
            fitted, after = _fit(context, checked, candidate, _worth(context, checked, candidate, best))
        except BrokenOff as why:
            say(f"    refused: {why}", context.grid.is_world_root)
            tried.append((candidate, str(why)))
            continue
        reason = refusal_of(checked, after, fitted, settings)
        reason = reason or _refusal_by_rivals(context, after.fitted, rivals_of(fitted, ranking, settings))
        say(f"    refused: {reason}", context.grid.is_world_root and reason is not None)
        if reason is not None:
            tried.append((fitted, reason))
        elif best is None or better(fitted, after, best):
            best = round_of(context, checked, after, fitted, ranking)
    return best


def _may_be_better(candidate: Candidate, best: Round, outlook: Outlook | None) -> bool:
    """Whether a candidate is worth a fit beside the best so far. Collective: all ranks of the grid."""
    leaves_nothing = best.after.remains.consistent
    if outlook is None or leaves_nothing or not may_be_better(candidate, best, leaves_nothing):
        return may_be_better(candidate, best, leaves_nothing)
    if outlook.comes_next(candidate, best):
        return False
    return may_be_better(candidate, best, enough=True) or not outlook.explains_rest(best)


def as_large_as_wanted(context: FitContext, fitted: Fitted, candidate: Candidate) -> Candidate:
    """Take more parameters of an effect's sort at once while that has more evidence. Collective: all ranks."""
    finding = candidate.finding
    while finding is not None and (larger := finding.effect.larger(context.setup)) is not None:
        (more,) = attribute(context, fitted, [larger])
        if not more.evidence.log_bayes_factor > finding.evidence.log_bayes_factor:
            break
        finding = more
        candidate = replace(candidate, finding=finding, log_bayes_factor=finding.evidence.log_bayes_factor)
    return candidate


def _worth(context: FitContext, before: Checked, candidate: Candidate, best: Round | None) -> Worth | None:
    """Return whether to go on with a candidate's fit, which may not come to more than the best one so far."""
    if best is None or candidate.finding is None:
        return None
    start, ahead = log_joint(context, before.fitted), best
    return lambda reached, gain: may_still_be_better(candidate, ahead, reached - start, gain)


def _refusal_by_rivals(context: FitContext, fitted: Fitted, rivals: Sequence[Candidate]) -> str | None:
    """Say beside which rival the last effect has too little evidence; None where there is none."""
    for rival in rivals:
        assert rival.finding is not None
        left = reconsider(context, fitted, beside=rival.finding).log_bayes_factor
        reason = refusal_beside(rival, left, context.problem.job.loop)
        if reason is not None:
            return reason
    return None


def try_control(
    context: FitContext, checked: Checked, ranking: Sequence[Candidate], found: Round | None
) -> Round | None:
    """Fit the control model with the most evidence where it may explain more than what was found.

    It is asked what effects are: one that the held-out data refuse explains nothing. Collective: all ranks of the grid.
    """
    controls = [one for one in _wanted(context, ranking) if one.is_control]
    if not controls or (found is not None and not may_be_better(controls[0], found, found.after.remains.consistent)):
        return None
    fitted, after = _fit(context, checked, controls[0])
    reason = refusal_of(checked, after, fitted, context.problem.job.loop)
    say(f"    refused: {reason}", context.grid.is_world_root and reason is not None)
    return None if reason is not None else round_of(context, checked, after, fitted, ranking)


def _wanted(context: FitContext, ranking: Sequence[Candidate]) -> list[Candidate]:
    """Return the candidates that have as much evidence as the job asks for."""
    return [one for one in ranking if one.log_bayes_factor >= context.problem.job.loop.min_log_bayes_factor]


def round_of(
    context: FitContext, before: Checked, after: Checked, fitted: Candidate, ranking: Sequence[Candidate]
) -> Round:
    """Tell what a fitted candidate changes. Collective: all ranks of the grid."""
    change = _beam_change(context, before.fitted, after.fitted)
    sigma, place = improvement(before, after, fitted), len(after.fitted.values.active) - 1
    return Round(fitted, tuple(ranking), before, after, sigma, change, place if fitted.finding else None)


def _fit(
    context: FitContext, checked: Checked, candidate: Candidate, worth: Worth | None = None
) -> tuple[Candidate, Checked]:
    """Fit a candidate and predict the held-out rows with it; ``worth`` as for `refit`.

    Collective: all ranks of the grid.
    """
    say(f"  trying {candidate.title} (ln BF {candidate.log_bayes_factor:.4g})", context.grid.is_world_root)
    fit = _fit_weights if candidate.finding is None else _fit_effect
    found, fitted = fit(context, checked.fitted, candidate, worth)
    after = check(context, fitted)
    if found.finding is not None:
        after = _by_heldout(context, after)
        effect = after.fitted.values.active[-1].effect
        found = replace(found, finding=replace(found.finding, effect=effect))
    told = f"held-out chi^2 {after.score.chi2:.4g}, rms {after.numbers.of_all['rms']:.4g} Jy"
    say(f"    {told} (ln BF {found.log_bayes_factor:.4g})", context.grid.is_world_root)
    return found, after


def _by_heldout(context: FitContext, checked: Checked) -> Checked:
    """Let the held-out rows say what of the last effect the fitted ones cannot, as they are the same with either.

    Such is a jump between two fitted times: it may be before or after those that lie between. Collective: all ranks of
    the grid.
    """
    *others, last = checked.fitted.values.active
    after = [checked]
    for effect in last.effect.alternatives(context.setup, last.used):
        values = replace(checked.fitted.values, active=(*others, replace(last, effect=effect)))
        after.append(check(context, replace(checked.fitted, values=values)))
    best = max(after, key=lambda one: one.score.log_density)
    return checked if best is checked else _by_heldout(context, best)


def _fit_effect(
    context: FitContext, before: Fitted, candidate: Candidate, worth: Worth | None
) -> tuple[Candidate, Fitted]:
    """Fit an effect and weigh it again where it has been fitted, as no effect is quite linear.

    What is unphysical there is left out; `BrokenOff` is raised where that is all of it.
    """
    assert candidate.finding is not None
    fitted = _fit_foremost(context, before, candidate.finding)
    if fitted is None:
        start = _started(context, candidate.finding, candidate.finding.evidence.prior_var)
        fitted = _fit_physically(context, before.values.extended(start), before, worth)
    again = reconsider(context, fitted)
    for _ in range(RULES.most_refits):
        last = fitted.values.active[-1]
        if is_same_prior(again.prior_var, last.prior_var(context.setup)):
            break
        start = restarted(context, last, again.prior_var)
        fitted = _fit_physically(context, before.values.extended(start), fitted, worth)
        again = reconsider(context, fitted)
    gained = rise(context, before, fitted)
    log_bayes_factor = again.log_bayes_factor - again.linear_gain + gained
    finding = Finding(fitted.values.active[-1].effect, replace(again, log_bayes_factor=log_bayes_factor))
    return replace(candidate, finding=finding, log_bayes_factor=log_bayes_factor), fitted


def _started(context: FitContext, finding: Finding, prior_var: FloatArray) -> Active:
    """Return an effect where its fit begins, with a prior of variances (n_params,)."""
    effect, x = finding.effect, np.where(prior_var > 0, finding.evidence.x, 0.0)
    return Active.start(effect, context.setup, prior_var, effect.begun(context.setup, x))


def _fit_foremost(context: FitContext, before: Fitted, finding: Finding) -> Fitted | None:
    """Fit the one element that matters most, such as a source; None where that says nothing of the others.

    Where candidates lie on a grid a bright source beside its place is made up for by several, which are hardly told
    from each other, so that a fit of all may go anywhere. Once the first is where it belongs the others are weighed
    again. Collective: all ranks of the grid.
    """
    effect, evidence = finding.effect, finding.evidence
    element = effect.parameters(context.setup).element
    several = len(np.unique(element[evidence.prior_var > 0])) > 1
    if not (effect.gets_simpler_when_fitted and several and len(evidence.alone)):
        return None
    foremost = element[np.where(evidence.prior_var > 0, evidence.alone, -np.inf).argmax()]
    start = _started(context, finding, np.where(element == foremost, evidence.prior_var, 0.0))
    try:
        fitted = fit_patiently(context, before.values.extended(start), before)
    except BrokenOff:
        return None
    is_told = fitted.diagnostics.converged and leave_out_unphysical(context, fitted, len(before.values.active)) is None
    return fitted if is_told else None


def _fit_physically(context: FitContext, values: Values, before: Fitted, worth: Worth | None) -> Fitted:
    """Fit, and again without those parts of the last effect that are unphysical, until none is.

    What is so at the linear optimum, where the values are, is left out before the first fit.
    """
    while may_be_unphysical(context, values.active[-1]):
        fitted = stepped(context, values, before)
        rest = _physical(context, fitted)
        if rest is None:
            break
        values = rest
    fitted = fit_patiently(context, values, before, worth)
    while (rest := _physical(context, fitted)) is not None:
        fitted = fit_patiently(context, rest, fitted, worth)
    return fitted


def _physical(context: FitContext, fitted: Fitted) -> Values | None:
    """Leave out what is unphysical of the last effect; None where nothing is. Collective: all ranks of the grid."""
    n_before = len(fitted.values.active) - 1
    found = leave_out_unphysical(context, fitted, n_before)
    if found is None:
        return None
    for line in found.told:
        say(f"    {line}", context.grid.is_world_root)
    if len(found.values.active) == n_before:
        raise BrokenOff(f"all that is left of it would have {fitted.values.active[-1].effect.unphysical}")
    return found.values


def _fit_weights(
    context: FitContext, before: Fitted, candidate: Candidate, worth: Worth | None
) -> tuple[Candidate, Fitted]:
    """Fit with changed weights, then fit the noise scales again to the residuals."""
    assert candidate.weights is not None
    found = candidate.weights

    def weighted(start: Fitted, fit: ReweightingFit) -> Fitted:
        added = Reweighted(found.change, fit.x, fit.std)
        return refit(context, replace(start.values, reweighted=(*before.values.reweighted, added)), start)

    fit = found.fit
    fitted = weighted(found.start, fit)
    for _ in range(found.change.times_refitted):
        fit = refit_reweighting(context, fitted, found.change)
        fitted = weighted(fitted, fit)
    weights = replace(found, fit=replace(fit, log_bayes_factor=found.fit.log_bayes_factor))
    return replace(candidate, weights=weights), fitted


def _beam_change(context: FitContext, before: Fitted, after: Fitted) -> float:
    """Return by how much the beam moved at most, on the one-degree grid and over channels."""
    basis, largest = context.problem.basis, 0.0
    for one, two in zip(before.fit.posteriors, after.fit.posteriors, strict=True):
        moved: FloatArray = two.mean - one.mean

        def change(za: FloatArray, az: FloatArray, moved: FloatArray = moved) -> Any:
            return basis.synthesize(moved, za, az)

        largest = max(largest, float(np.abs(evaluate_on_grid(change)).max()))
    return float(max(context.grid.world.allgather(largest)))
