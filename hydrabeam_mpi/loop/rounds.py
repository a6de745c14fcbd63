"""The rounds: weigh all effects, try the best, keep it if held-out data agree, until nothing is left to find."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.diagnose import evaluate_on_grid
from hydrabeam_mpi.effects.base import Effect
from hydrabeam_mpi.effects.basis_truncation import BasisTruncation
from hydrabeam_mpi.effects.noise_level import NoiseLevel
from hydrabeam_mpi.effects.reweighting import Reweighting, ReweightingFit
from hydrabeam_mpi.inference import Clock
from hydrabeam_mpi.loop.attribution import Finding, attribute, reconsider
from hydrabeam_mpi.loop.blocks import blocks_of
from hydrabeam_mpi.loop.candidates import (
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
from hydrabeam_mpi.loop.heldout import whiten
from hydrabeam_mpi.loop.refit import Space, refit
from hydrabeam_mpi.loop.remains import remains_of
from hydrabeam_mpi.loop.reweighting import WeightsFound, fit_reweightings, refit_reweighting
from hydrabeam_mpi.loop.state import Active, Reweighted, State
from hydrabeam_mpi.progress import say

MAX_TRIES = 6
"""Effects that are fitted in one round at most."""
TIMES_SCALED = 2
"""Times that scales of the noise are fitted again to the residuals of a fit with them."""
MAX_PRUNED = 3
"""Times at most that an effect is fitted again with another prior, or with fewer elements."""
WEAK_SIGMA = 4.0
"""Significance below which an element with a place is given up; among so many places noise has this now and then."""


@dataclass
class Course:
    """How the loop went.

    Attributes
    ----------
    first, last : Checked
        Before the first and after the last round.
    rounds : list of Round
    tried : list of (Candidate, str)
        What evidence wanted and held-out data refused, with the reason.
    ranking : tuple of Candidate
        Of the last search, in which nothing more was found.
    foreign : Round, optional
        What explained the data better than any effect in the last search, and is none of them; not added.
    """

    first: Checked
    last: Checked
    rounds: list[Round] = field(default_factory=list)
    tried: list[tuple[Candidate, str]] = field(default_factory=list)
    ranking: tuple[Candidate, ...] = ()
    foreign: Round | None = None


def run_rounds(
    space: Space, state: State, effects: Sequence[Effect], changes: Sequence[Reweighting], clock: Clock
) -> Course:
    """Look for effects until there is none left that the data want.

    Collective: all ranks of the grid.
    """
    settings = space.problem.job.loop
    with clock.time("fit"):
        checked = check(space, refit(space, state))
    course = Course(checked, checked)
    speaks = space.grid.is_world_root
    for number in range(settings.max_rounds + 1):
        say(f"round {number + 1}: held-out chi^2 {checked.blocks.chi2:.4g}; weighing effects", speaks)
        with clock.time("attribution"):
            ranking = rank(space, checked.state, effects, changes)
        course.ranking = ranking
        if number == settings.max_rounds:
            break
        with clock.time("trials"):
            added = _try(space, checked, ranking, course)
        if added is not None and added.candidate.is_foreign:
            course.foreign = added
            say(f"  nothing is added: no effect comes near {added.candidate.title}", speaks)
            break
        if added is None:
            break
        course.rounds.append(added)
        effects = [_next_of(space, effect, added.after.state) for effect in effects]
        course.last = checked = added.after
    return course


def _next_of(space: Space, effect: Effect, state: State) -> Effect:
    """Return the effect to look for after those of the state: more modes where all of the next ones are in use."""
    last = state.active[-1].effect if state.active else None
    if isinstance(effect, BasisTruncation) and isinstance(last, BasisTruncation):
        return BasisTruncation(last.n_before + len(last.parameters(space.experiment)))
    return effect


def check(space: Space, state: State) -> Checked:
    """Predict the held-out rows of a fitted state. Collective: all ranks of the grid."""
    whitened = whiten(space, state)
    return Checked(state, whitened, blocks_of(space, whitened), remains_of(space, state, whitened))


def rank(
    space: Space, state: State, effects: Sequence[Effect], changes: Sequence[Reweighting]
) -> tuple[Candidate, ...]:
    """Order everything that may be tried by its evidence. Collective: all ranks of the grid."""
    candidates = [
        Candidate(finding.kind, finding.effect.title, finding.evidence.log_bayes_factor, finding)
        for finding in attribute(space, state, effects)
    ]
    done = {one.change.kind for one in state.reweighted}
    candidates += [
        Candidate(found.change.kind, found.change.title, found.fit.log_bayes_factor, weights=found)
        for found in fit_reweightings(space, state, [one for one in changes if one.kind not in done])
    ]
    return tuple(sorted(candidates, key=lambda one: -one.log_bayes_factor))


def _try(space: Space, checked: Checked, ranking: Sequence[Candidate], course: Course) -> Round | None:
    """Fit the candidates that may be the best; return the best of those that held-out data confirm."""
    settings = space.problem.job.loop
    wanted = [one for one in ranking if one.log_bayes_factor >= settings.min_log_bayes_factor]
    best: Round | None = None
    enough = False
    course.tried += [(one, absorbed_reason(one)) for one in wanted if is_hopeless(one, wanted)]
    for candidate in in_order([one for one in wanted if not is_hopeless(one, wanted)], MAX_TRIES):
        if best is not None and not may_be_better(candidate, best, enough):
            continue
        say(f"  trying {candidate.title} (ln BF {candidate.log_bayes_factor:.4g})", space.grid.is_world_root)
        fitted, after = _fit(space, checked, candidate)
        sigma = improvement(checked, after, fitted)
        reason = refusal_of(checked, after, candidate, fitted, sigma, settings)
        say(
            f"    held-out chi^2 {after.blocks.chi2:.4g} (ln BF {fitted.log_bayes_factor:.4g})"
            + (f", refused: {reason}" if reason else ""),
            space.grid.is_world_root,
        )
        if reason is not None:
            course.tried.append((fitted, reason))
        elif best is None or is_better(fitted, after, best):
            change = _beam_change(space, checked.state, after.state)
            best = Round(fitted, tuple(ranking), checked, after, sigma, change)
            enough = after.remains.consistent
    return best


def _fit(space: Space, checked: Checked, candidate: Candidate) -> tuple[Candidate, Checked]:
    """Fit a candidate and weigh it again where it has been fitted, as no effect is quite linear."""
    state = checked.state
    if candidate.finding is None:
        assert candidate.weights is not None
        return _fit_weights(space, state, candidate, candidate.weights)
    effect, evidence = candidate.finding.effect, candidate.finding.evidence
    fitted = refit(space, state.extended(Active.start(effect, space.experiment, evidence.prior_var, evidence.x)))
    again = reconsider(space, fitted)
    for _ in range(MAX_PRUNED):
        prior_var = _without_weak(space, fitted.active[-1], again.prior_var)
        same = np.array_equal(prior_var > 0, evidence.prior_var > 0)
        if same and np.allclose(prior_var, evidence.prior_var, rtol=1.0, atol=0.0):
            break
        evidence = replace(again, prior_var=prior_var)
        fitted = refit(space, state.extended(_restarted(space, fitted.active[-1], prior_var)))
        again = reconsider(space, fitted)
    gained = _gain(space, state, fitted)
    log_bayes_factor = again.log_bayes_factor - again.linear_gain + gained
    finding = Finding(effect, replace(again, log_bayes_factor=log_bayes_factor))
    return replace(candidate, finding=finding, log_bayes_factor=log_bayes_factor), check(space, fitted)


def _fit_weights(space: Space, state: State, candidate: Candidate, found: WeightsFound) -> tuple[Candidate, Checked]:
    """Fit with other weights, and scales of the noise again to what that leaves."""

    def weighted(start: State, fit: ReweightingFit) -> State:
        added = Reweighted(found.change, fit.x, fit.std)
        return refit(space, replace(start, reweighted=[*state.reweighted, added]))

    fit = found.fit
    fitted = weighted(found.start, fit)
    for _ in range(TIMES_SCALED if isinstance(found.change, NoiseLevel) else 0):
        fit = refit_reweighting(space, fitted, found.change)
        fitted = weighted(fitted, fit)
    weights = replace(found, fit=replace(fit, log_bayes_factor=found.fit.log_bayes_factor))
    return replace(candidate, weights=weights), check(space, fitted)


def _without_weak(space: Space, active: Active, prior_var: FloatArray) -> FloatArray:
    """Take the prior from elements with a place or the like that have nothing there once they have been fitted to it.

    Such are the ghosts of a source in the lobes of an array, which stand in for an error of its first position.
    """
    parameters = active.effect.parameters(space.experiment)
    told = (active.std > 0) & ~parameters.refined
    sigmas = np.where(told, np.abs(active.x) / np.where(told, active.std, 1.0), 0.0).max(axis=0)
    n_elements = int(parameters.element.max(initial=-1)) + 1
    best, placed = np.zeros(n_elements), np.zeros(n_elements, dtype=bool)
    np.maximum.at(best, parameters.element, sigmas)
    np.logical_or.at(placed, parameters.element, parameters.refined)
    weak = (placed & (best < WEAK_SIGMA))[parameters.element]
    return np.where(weak, 0.0, prior_var) if np.any(prior_var[~weak] > 0) else prior_var


def _restarted(space: Space, active: Active, prior_var: FloatArray) -> Active:
    """Begin again with another prior from where the effect has been fitted."""
    refined = active.effect.parameters(space.experiment).refined
    start = np.where((prior_var > 0) | refined, active.x, 0.0)
    return Active.start(active.effect, space.experiment, prior_var, start)


def _gain(space: Space, before: State, after: State) -> float:
    """Return by how much the last active effect raised ln(likelihood x prior), over all channels."""
    last = after.active[-1]
    used = last.used
    rows = last.x[:1] if last.effect.shared else last.x
    refined = last.effect.parameters(space.experiment).refined[used]
    penalty = 0.5 * float(np.sum((rows[:, used] ** 2 / last.prior_var[used])[:, ~refined]))
    return space.over_channels(after.log_joint - before.log_joint) - penalty


def _beam_change(space: Space, before: State, after: State) -> float:
    """Return by how much the beam moved at most, on the one-degree grid and over channels."""
    basis, largest = space.problem.basis, 0.0
    for one, two in zip(before.posteriors, after.posteriors, strict=True):
        moved: FloatArray = two.mean - one.mean

        def change(za: FloatArray, az: FloatArray, moved: FloatArray = moved) -> Any:
            return basis.synthesize(moved, za, az)

        largest = max(largest, float(np.abs(evaluate_on_grid(change)).max()))
    return float(max(space.grid.world.allgather(largest)))
