"""The rounds: weigh all effects, try the best, keep it if held-out data agree, until nothing is left to find."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.interface.reweighting import Reweighting, ReweightingFit
from hydrabeam_mpi.fit.clock import Clock
from hydrabeam_mpi.fit.gauss_newton import FitContext, refit
from hydrabeam_mpi.fit.heldout import whiten
from hydrabeam_mpi.fit.settle import refined, settle
from hydrabeam_mpi.fit.state import Active, Fitted, Reweighted, Values
from hydrabeam_mpi.loop.attribution.score_effects import Finding, attribute, reconsider
from hydrabeam_mpi.loop.attribution.score_noise import WeightsFound, fit_reweightings, refit_reweighting
from hydrabeam_mpi.loop.residuals.remains import remains_of
from hydrabeam_mpi.loop.selection.acceptance import (
    Candidate,
    Checked,
    Round,
    absorbed_reason,
    improvement,
    in_order,
    is_better,
    is_hopeless,
    may_be_better,
    refusal_of,
)
from hydrabeam_mpi.loop.selection.heldout_numbers import heldout_numbers
from hydrabeam_mpi.loop.selection.heldout_score import heldout_score
from hydrabeam_mpi.result.summary import evaluate_on_grid
from hydrabeam_mpi.terminal.progress import say

MAX_TRIES = 6
"""Effects that are fitted in one round at most."""
MAX_PRUNED = 3
"""Times at most that an effect is fitted again with another prior, or with fewer elements."""
WEAK_SIGMA = 4.0
"""Significance (sigma) below which an element with a position, such as a source, is dropped after the fit: among many
trial positions noise alone reaches this now and then.
"""


@dataclass
class History:
    """How the loop went.

    Attributes
    ----------
    first, last : Checked
        Before the first and after the last round.
    rounds : list of Round
    tried : list of (Candidate, str)
        Candidates that had the evidence but were refused by the held-out data, with the reason.
    ranking : tuple of Candidate
        Of the last search, in which nothing more was found.
    control : Round, optional
        Control model that explained the data better than any effect in the last search; not added.
    """

    first: Checked
    last: Checked
    rounds: list[Round] = field(default_factory=list)
    tried: list[tuple[Candidate, str]] = field(default_factory=list)
    ranking: tuple[Candidate, ...] = ()
    control: Round | None = None


def begin(context: FitContext, values: Values, clock: Clock) -> History:
    """Fit what is known before the first round. Collective: all ranks of the grid."""
    with clock.time("fit"):
        checked = check(context, refit(context, values))
    return History(checked, checked)


def settle_last(context: FitContext, history: History) -> None:
    """Go on with the last fit until nothing moves, so that what is written of it can be computed again.

    Effects are described by what has been fitted first. Collective: all ranks of the grid.
    """
    last = check(context, settle(context, refined(history.last.fitted)))
    history.last = last
    if history.rounds:
        history.rounds[-1] = replace(history.rounds[-1], after=last)
    else:
        history.first = last


def run_rounds(
    context: FitContext,
    history: History,
    effects: Sequence[Effect],
    changes: Sequence[Reweighting],
    clock: Clock,
    keep: Callable[[History], None],
) -> None:
    """Look for effects until no further one improves the model.

    Collective: all ranks of the grid.

    Parameters
    ----------
    context : FitContext
    history : History
        So far; it goes on.
    effects, changes
        To look for.
    clock : Clock
        Receives the phases "attribution", "trials" and "keep".
    keep : callable
        Gets the history after each round that has found something.
    """
    settings, checked = context.problem.job.loop, history.last
    speaks = context.grid.is_world_root
    effects = _next_of(context, effects, checked.fitted.values)
    for number in range(len(history.rounds), settings.max_rounds + 1):
        say(f"round {number + 1}: {say_heldout(checked.score.chi2, checked.numbers.of_all)}; weighing effects", speaks)
        with clock.time("attribution"):
            ranking = rank(context, checked.fitted, effects, changes)
        history.ranking = ranking
        if number == settings.max_rounds:
            break
        with clock.time("trials"):
            added = _try(context, checked, ranking, history)
        if added is not None and added.candidate.is_control:
            history.control = added
            say(f"  nothing is added: no effect comes near {added.candidate.title}", speaks)
            break
        if added is None:
            break
        history.rounds.append(added)
        effects = _next_of(context, effects, added.after.fitted.values)
        history.last = checked = added.after
        with clock.time("keep"):
            keep(history)


def say_heldout(chi2: float, now: dict[str, float]) -> str:
    """Tell in a line how well held-out data are predicted, beside the model beam, zero and the noise."""
    return (
        f"held-out chi^2 {chi2:.4g} (over the noise alone {now['noise_only_chi2']:.4g}), ln density "
        f"{now['log_density']:.6g}, rms {now['rms']:.4g} Jy ({now['explained']:.1%} explained; model beam "
        f"{now['rms_model']:.4g}, with its best scale {now['rms_model_scaled']:.4g}, zero {now['rms_zero']:.4g}, noise "
        f"{now['rms_noise']:.4g} Jy)"
    )


def _next_of(context: FitContext, effects: Sequence[Effect], values: Values) -> Sequence[Effect]:
    """Return the effects to look for after those of the model."""
    for one in values.active:
        effects = [effect.next_after(context.setup, one.effect) for effect in effects]
    return effects


def check(context: FitContext, fitted: Fitted) -> Checked:
    """Predict the held-out rows. Collective: all ranks of the grid."""
    whitened = whiten(context, fitted)
    remains = remains_of(context, fitted, whitened)
    return Checked(fitted, heldout_score(context, whitened), remains, heldout_numbers(context, whitened))


def rank(
    context: FitContext, fitted: Fitted, effects: Sequence[Effect], changes: Sequence[Reweighting]
) -> tuple[Candidate, ...]:
    """Order everything that may be tried by its evidence. Collective: all ranks of the grid."""
    candidates = [
        Candidate(finding.kind, finding.effect.title, finding.evidence.log_bayes_factor, finding)
        for finding in attribute(context, fitted, effects)
    ]
    done = {one.change.kind for one in fitted.values.reweighted}
    candidates += [
        Candidate(found.change.kind, found.change.title, found.fit.log_bayes_factor, weights=found)
        for found in fit_reweightings(context, fitted, [one for one in changes if one.kind not in done])
    ]
    return tuple(sorted(candidates, key=lambda one: -one.log_bayes_factor))


def _try(context: FitContext, checked: Checked, ranking: Sequence[Candidate], history: History) -> Round | None:
    """Fit the candidates that may be the best; return the best of those that held-out data confirm."""
    settings = context.problem.job.loop
    wanted = [one for one in ranking if one.log_bayes_factor >= settings.min_log_bayes_factor]
    best: Round | None = None
    enough = False
    history.tried += [(one, absorbed_reason(one)) for one in wanted if is_hopeless(one, wanted)]
    for candidate in in_order([one for one in wanted if not is_hopeless(one, wanted)], MAX_TRIES):
        if best is not None and not may_be_better(candidate, best, enough):
            continue
        say(f"  trying {candidate.title} (ln BF {candidate.log_bayes_factor:.4g})", context.grid.is_world_root)
        fitted, after = _fit(context, checked, candidate)
        sigma = improvement(checked, after, fitted)
        reason = refusal_of(checked, after, candidate, fitted, sigma, settings)
        say(
            f"    held-out chi^2 {after.score.chi2:.4g}, rms {after.numbers.of_all['rms']:.4g} Jy "
            f"(ln BF {fitted.log_bayes_factor:.4g})" + (f", refused: {reason}" if reason else ""),
            context.grid.is_world_root,
        )
        if reason is not None:
            history.tried.append((fitted, reason))
        elif best is None or is_better(fitted, after, best):
            change = _beam_change(context, checked.fitted, after.fitted)
            best = Round(fitted, tuple(ranking), checked, after, sigma, change)
            enough = after.remains.consistent
    return best


def _fit(context: FitContext, checked: Checked, candidate: Candidate) -> tuple[Candidate, Checked]:
    """Fit a candidate and weigh it again where it has been fitted, as no effect is quite linear."""
    before = checked.fitted
    if candidate.finding is None:
        assert candidate.weights is not None
        return _fit_weights(context, before, candidate, candidate.weights)
    effect, evidence = candidate.finding.effect, candidate.finding.evidence
    start = Active.start(effect, context.setup, evidence.prior_var, evidence.x)
    fitted = refit(context, before.values.extended(start), before)
    again = reconsider(context, fitted)
    for _ in range(MAX_PRUNED):
        prior_var = _without_weak(context, fitted, again.prior_var)
        same = np.array_equal(prior_var > 0, evidence.prior_var > 0)
        if same and np.allclose(prior_var, evidence.prior_var, rtol=1.0, atol=0.0):
            break
        evidence = replace(again, prior_var=prior_var)
        start = _restarted(context, fitted.values.active[-1], prior_var)
        fitted = refit(context, before.values.extended(start), before)
        again = reconsider(context, fitted)
    gained = _gain(context, before, fitted)
    log_bayes_factor = again.log_bayes_factor - again.linear_gain + gained
    finding = Finding(effect, replace(again, log_bayes_factor=log_bayes_factor))
    return replace(candidate, finding=finding, log_bayes_factor=log_bayes_factor), check(context, fitted)


def _fit_weights(
    context: FitContext, before: Fitted, candidate: Candidate, found: WeightsFound
) -> tuple[Candidate, Checked]:
    """Fit with changed weights, then fit the noise scales again to the residuals."""

    def weighted(start: Fitted, fit: ReweightingFit) -> Fitted:
        added = Reweighted(found.change, fit.x, fit.std)
        return refit(context, replace(start.values, reweighted=(*before.values.reweighted, added)), start)

    fit = found.fit
    fitted = weighted(found.start, fit)
    for _ in range(found.change.times_refitted):
        fit = refit_reweighting(context, fitted, found.change)
        fitted = weighted(fitted, fit)
    weights = replace(found, fit=replace(fit, log_bayes_factor=found.fit.log_bayes_factor))
    return replace(candidate, weights=weights), check(context, fitted)


def _without_weak(context: FitContext, fitted: Fitted, prior_var: FloatArray) -> FloatArray:
    """Drop elements, such as sources, that turn out insignificant once their own positions have been fitted.

    An example are ghosts of a source in the array's sidelobes, which only made up for an error of its first position.
    """
    last, std = fitted.values.active[-1], fitted.fit.std[-1]
    parameters = last.effect.parameters(context.setup)
    told = (std > 0) & ~parameters.nonlinear
    sigmas = np.where(told, np.abs(last.x) / np.where(told, std, 1.0), 0.0).max(axis=0)
    n_elements = int(parameters.element.max(initial=-1)) + 1
    best, placed = np.zeros(n_elements), np.zeros(n_elements, dtype=bool)
    np.maximum.at(best, parameters.element, sigmas)
    np.logical_or.at(placed, parameters.element, parameters.nonlinear)
    weak = (placed & (best < WEAK_SIGMA))[parameters.element]
    return np.where(weak, 0.0, prior_var) if np.any(prior_var[~weak] > 0) else prior_var


def _restarted(context: FitContext, active: Active, prior_var: FloatArray) -> Active:
    """Restart the fit from the fitted values with another prior."""
    nonlinear = active.effect.parameters(context.setup).nonlinear
    start = np.where((prior_var > 0) | nonlinear, active.x, 0.0)
    return Active.start(active.effect, context.setup, prior_var, start)


def _gain(context: FitContext, before: Fitted, after: Fitted) -> float:
    """Return by how much the last active effect raised ln(likelihood x prior), over all channels."""
    last = after.values.active[-1]
    nonlinear = last.effect.parameters(context.setup).nonlinear[last.used]
    log_prior = last.prior.log_density(np.where(nonlinear, 0.0, last.x[:, last.used]))
    return context.over_channels(after.diagnostics.log_joint - before.diagnostics.log_joint) + log_prior


def _beam_change(context: FitContext, before: Fitted, after: Fitted) -> float:
    """Return by how much the beam moved at most, on the one-degree grid and over channels."""
    basis, largest = context.problem.basis, 0.0
    for one, two in zip(before.fit.posteriors, after.fit.posteriors, strict=True):
        moved: FloatArray = two.mean - one.mean

        def change(za: FloatArray, az: FloatArray, moved: FloatArray = moved) -> Any:
            return basis.synthesize(moved, za, az)

        largest = max(largest, float(np.abs(evaluate_on_grid(change)).max()))
    return float(max(context.grid.world.allgather(largest)))
