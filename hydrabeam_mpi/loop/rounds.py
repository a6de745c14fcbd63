"""The rounds: weigh all effects, try the best, keep it if held-out data agree, until nothing is left to find."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hydrabeam_mpi.config.effects import Loop as LoopSettings
from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.diagnose import evaluate_on_grid
from hydrabeam_mpi.effects.base import Effect
from hydrabeam_mpi.effects.basis_truncation import BasisTruncation
from hydrabeam_mpi.effects.reweighting import Reweighting, ReweightingFit
from hydrabeam_mpi.inference import Clock
from hydrabeam_mpi.loop.attribution import Finding, attribute, reconsider
from hydrabeam_mpi.loop.heldout import Blocks, Whitened, blocks_of, fall_significance, whiten
from hydrabeam_mpi.loop.refit import Space, refit
from hydrabeam_mpi.loop.remains import Remains, remains_of
from hydrabeam_mpi.loop.reweighting import fit_reweightings
from hydrabeam_mpi.loop.state import Active, Reweighted, State
from hydrabeam_mpi.progress import say

MAX_TRIES = 6
"""Effects that are fitted in one round at most."""
SAME = 0.01
"""Relative difference of evidences that the approximations of strongly nonlinear effects do not resolve."""
TOO_SMALL = 0.7
"""Held-out reduced chi^2 below which predictions claim far less than they should."""
NEAR = 0.1
"""Effects with less than this part of the best one's evidence are not fitted."""
UNDECIDED_NATS = 5.0
"""Effects whose evidence is nearer than this to the best one's cannot be told from it."""


@dataclass(frozen=True)
class Checked:
    """A fitted state and its held-out data."""

    state: State
    whitened: Whitened
    blocks: Blocks


@dataclass(frozen=True)
class Candidate:
    """Something to try: an effect or a change of weights."""

    kind: str
    title: str
    log_bayes_factor: float
    finding: Finding | None = None
    change: Reweighting | None = None
    fit: ReweightingFit | None = None


@dataclass(frozen=True)
class Round:
    """An effect that was added, and what it changed."""

    candidate: Candidate
    ranking: tuple[Candidate, ...]
    before: Checked
    after: Checked
    sigma: float
    beam_change: float


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
    """

    first: Checked
    last: Checked
    rounds: list[Round] = field(default_factory=list)
    tried: list[tuple[Candidate, str]] = field(default_factory=list)
    ranking: tuple[Candidate, ...] = ()


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
    return Checked(state, whitened, blocks_of(space, whitened))


def rank(
    space: Space, state: State, effects: Sequence[Effect], changes: Sequence[Reweighting]
) -> tuple[Candidate, ...]:
    """Order everything that may be tried by its evidence. Collective: all ranks of the grid."""
    candidates = [
        Candidate(finding.kind, finding.effect.title, finding.evidence.log_bayes_factor, finding)
        for finding in attribute(space, state, effects)
    ]
    done = {one.change.kind for one in state.reweighted}
    for change, fit in fit_reweightings(space, state, [one for one in changes if one.kind not in done]):
        candidates.append(Candidate(change.kind, change.title, fit.log_bayes_factor, None, change, fit))
    return tuple(sorted(candidates, key=lambda one: -one.log_bayes_factor))


def _try(space: Space, checked: Checked, ranking: Sequence[Candidate], course: Course) -> Round | None:
    """Fit the candidates that may be the best; return the best of those that held-out data confirm."""
    settings = space.problem.job.loop
    wanted = [one for one in ranking if one.log_bayes_factor >= settings.min_log_bayes_factor]
    best: Round | None = None
    enough = False
    for candidate in _in_order(wanted)[:MAX_TRIES]:
        if best is not None and not _may_be_better(candidate, best, enough):
            continue
        say(f"  trying {candidate.title} (ln BF {candidate.log_bayes_factor:.4g})", space.grid.is_world_root)
        fitted, after = _fit(space, checked, candidate)
        remains = remains_of(space, after.whitened)
        sigma = _improvement(checked, after, fitted, remains)
        reason = _refusal(checked, after, fitted, remains, sigma, settings)
        say(
            f"    held-out chi^2 {after.blocks.chi2:.4g} (ln BF {fitted.log_bayes_factor:.4g})"
            + (f", refused: {reason}" if reason else ""),
            space.grid.is_world_root,
        )
        if reason is not None:
            course.tried.append((fitted, reason))
        elif best is None or _is_better(fitted, after, best):
            change = _beam_change(space, checked.state, after.state)
            best = Round(fitted, tuple(ranking), checked, after, sigma, change)
            enough = remains.consistent
    return best


def _in_order(wanted: Sequence[Candidate]) -> list[Candidate]:
    """Order candidates for trial: by evidence, but a change of the weights after all effects that come near it.

    What has a structure is no noise, whereas a larger noise seems to explain anything.
    """
    top = max((one.log_bayes_factor for one in wanted), default=0.0)

    def place(one: Candidate) -> int:
        return 1 if one.finding is None else 0 if one.log_bayes_factor >= NEAR * top else 2

    return sorted(wanted, key=place)


def _is_better(fitted: Candidate, after: Checked, best: Round) -> bool:
    """Whether a fitted effect is better than the best so far.

    By evidence; where that is nearly the same, relative to how much of it the approximations are good for, by the error
    on held-out data.
    """
    one, two = fitted.log_bayes_factor, best.candidate.log_bayes_factor
    if abs(one - two) < SAME * max(one, two):
        return after.blocks.chi2 < best.after.blocks.chi2
    return one > two


def _may_be_better(candidate: Candidate, best: Round, enough: bool) -> bool:
    """Whether an effect with less evidence than the best one fitted so far may have more once it is fitted.

    Effects are only roughly linear, so that what comes near is fitted too. Where the best one leaves nothing
    (``enough``) another can only be simpler. A structure that was found is no noise.
    """
    if candidate.finding is None or candidate.log_bayes_factor < NEAR * best.candidate.log_bayes_factor:
        return False
    return not enough or _complexity(candidate) < _complexity(best.candidate)


def _complexity(candidate: Candidate) -> float:
    return candidate.finding.evidence.effective_parameters if candidate.finding else 0.0


def _fit(space: Space, checked: Checked, candidate: Candidate) -> tuple[Candidate, Checked]:
    """Fit a candidate and weigh it again where it has been fitted, as no effect is quite linear."""
    state = checked.state
    if candidate.finding is None:
        assert candidate.change is not None
        assert candidate.fit is not None
        extended = replace(state, reweighted=[*state.reweighted, _reweighted(candidate)])
        return candidate, check(space, refit(space, extended))
    effect, evidence = candidate.finding.effect, candidate.finding.evidence
    fitted = refit(space, state.extended(Active.start(effect, space.experiment, evidence.prior_var, evidence.x)))
    again = reconsider(space, fitted)
    if not np.allclose(again.prior_var, evidence.prior_var, rtol=1.0, atol=0.0):
        start = np.where(again.prior_var > 0, fitted.active[-1].x, 0.0)
        start = np.where(effect.parameters(space.experiment).refined, fitted.active[-1].x, start)
        fitted = refit(space, state.extended(Active.start(effect, space.experiment, again.prior_var, start)))
    gained = _gain(space, state, fitted)
    log_bayes_factor = again.log_bayes_factor - again.linear_gain + gained
    finding = Finding(effect, replace(again, log_bayes_factor=log_bayes_factor))
    return replace(candidate, finding=finding, log_bayes_factor=log_bayes_factor), check(space, fitted)


def _reweighted(candidate: Candidate) -> Reweighted:
    assert candidate.change is not None
    assert candidate.fit is not None
    return Reweighted(candidate.change, candidate.fit.x, candidate.fit.std)


def _gain(space: Space, before: State, after: State) -> float:
    """Return by how much the last active effect raised ln(likelihood x prior), over all channels."""
    last = after.active[-1]
    used = last.used
    rows = last.x[:1] if last.effect.shared else last.x
    refined = last.effect.parameters(space.experiment).refined[used]
    penalty = 0.5 * float(np.sum((rows[:, used] ** 2 / last.prior_var[used])[:, ~refined]))
    mine = float(np.sum(after.log_joint - before.log_joint)) if space.grid.is_group_root else 0.0
    return float(sum(space.grid.world.allgather(mine))) - penalty


def _improvement(before: Checked, after: Checked, candidate: Candidate, remains: Remains) -> float:
    """Return the significance with which held-out data got better.

    From blocks, whose falls differ however large they are; where nothing is left but noise, from that.
    """
    fall = (before.blocks.chi2 - after.blocks.chi2) * np.sqrt(before.blocks.n_data)
    if candidate.finding is None:
        return float(abs(fall))
    by_blocks = fall_significance(before.blocks, after.blocks)
    return max(by_blocks, float(fall)) if remains.consistent else by_blocks


def _refusal(
    before: Checked, after: Checked, candidate: Candidate, remains: Remains, sigma: float, settings: LoopSettings
) -> str | None:
    """Say why a fitted candidate is not kept; None where it is."""
    if not candidate.log_bayes_factor >= settings.min_log_bayes_factor:
        return f"its log Bayes factor is {candidate.log_bayes_factor:.4g} once it is fitted"
    if candidate.change is not None:
        if abs(after.blocks.chi2 - 1) > abs(before.blocks.chi2 - 1):
            return f"held-out chi^2 goes from {before.blocks.chi2:.4g} to {after.blocks.chi2:.4g}"
        return None if remains.white else f"what is left is not white: {remains.why}"
    if after.blocks.chi2 < TOO_SMALL:
        return f"it is so uncertain that it predicts nothing: held-out chi^2 {after.blocks.chi2:.4g}"
    if not after.blocks.chi2 < before.blocks.chi2:
        return f"held-out chi^2 does not fall: {before.blocks.chi2:.4g} to {after.blocks.chi2:.4g}"
    if sigma < settings.min_heldout_sigma:
        return f"held-out chi^2 falls by {sigma:.1f} sigma only, {before.blocks.chi2:.4g} to {after.blocks.chi2:.4g}"
    return None


def _beam_change(space: Space, before: State, after: State) -> float:
    """Return by how much the beam moved at most, on the one-degree grid and over channels."""
    basis, largest = space.problem.basis, 0.0
    for one, two in zip(before.posteriors, after.posteriors, strict=True):
        moved: FloatArray = two.mean - one.mean

        def change(za: FloatArray, az: FloatArray, moved: FloatArray = moved) -> Any:
            return basis.synthesize(moved, za, az)

        largest = max(largest, float(np.abs(evaluate_on_grid(change)).max()))
    return float(max(space.grid.world.allgather(largest)))


def indistinguishable(candidate: Candidate, ranking: Sequence[Candidate]) -> list[str]:
    """Name the effects that explain the residual as well as the candidate, within the evidence's own reach."""
    near = candidate.log_bayes_factor - UNDECIDED_NATS
    return [one.kind for one in ranking if one.kind != candidate.kind and one.log_bayes_factor > near]
