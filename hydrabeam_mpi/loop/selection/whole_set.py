"""Effects that together explain what is left are fitted as a whole, and each has to hold beside the others.

The search over all effects (`attribution.joint_search`) is linear. One of its set by itself is fitted to data in which
the others are still missing: it takes up parts of them, with many parameters, and rivals of it that take up more come
first. The joint fit of the set is exact, and where it holds there is nothing of that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import takewhile
from typing import NamedTuple

from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.error_scale import left_of
from hydrabeam_mpi.fit.gauss_newton import BrokenOff
from hydrabeam_mpi.fit.state import Fitted
from hydrabeam_mpi.fit.step import solved_at
from hydrabeam_mpi.loop.attribution.evidence import Evidence
from hydrabeam_mpi.loop.attribution.reconsider import reconsider, reconsider_each
from hydrabeam_mpi.loop.attribution.score_effects import Finding
from hydrabeam_mpi.loop.rules import RULES
from hydrabeam_mpi.loop.selection.acceptance import Candidate, Checked, Round
from hydrabeam_mpi.loop.selection.candidate_fits import by_heldout
from hydrabeam_mpi.loop.selection.foremost import started
from hydrabeam_mpi.loop.selection.physical import leave_out_unphysical, price_of_fitted
from hydrabeam_mpi.loop.selection.predictions import check
from hydrabeam_mpi.loop.selection.refits import fit_patiently, rise, with_best_variant
from hydrabeam_mpi.loop.selection.refusal import rivals_of
from hydrabeam_mpi.loop.selection.revision import reweigh
from hydrabeam_mpi.loop.selection.trials import least_beside, refusal_of_fit, round_of
from hydrabeam_mpi.loop.selection.weighing import Together, Weighed
from hydrabeam_mpi.terminal.progress import say

Tried = list[tuple[Candidate, str]]


def try_set(context: FitContext, checked: Checked, weighed: Weighed, tried: Tried) -> tuple[Round, ...]:
    """Fit the effects of the set as a whole, and of simpler ones; return the best as rounds.

    The simplest comes first: where it leaves nothing, one with more parameters and no more evidence need not be fitted.
    What a set has beyond the effects of the best, and what was refused in a set before, is left to the next round, in
    which it is looked for beside the best.

    Of a set that leaves more than noise, and not far less than the best effect by itself, those alone are fitted that
    none of the others stands for. There are no rounds where none holds. Collective: all ranks of the grid.
    """
    best: tuple[Round, ...] = ()
    sets = (weighed.together, *weighed.simpler)
    if not weighed.explains:
        above = left_of(context, checked.fitted).above_noise
        little = RULES.near * (above - weighed.most_by_itself)
        as_fitted = [
            one if above - one.log_bayes_factor < little else _that_none_stands_for(one, weighed) for one in sets
        ]
        sets = (weighed.with_drift, *as_fitted)
    for of_set in sorted(sets, key=lambda one: one.n_parameters):
        one = of_set.without({candidate.name for candidate, _ in tried})
        if best and best[-1].after.remains.consistent:
            reached = sum(found.candidate.log_bayes_factor for found in best)
            if one.log_bayes_factor <= reached:
                continue
        if best and {found.candidate.name for found in best} < {member.name for member in of_set.members}:
            continue
        found = _try_one_set(context, checked, weighed, one, tried)
        if found and (not best or as_one(found).evidence_of_all > as_one(best).evidence_of_all):
            best = found
    return best


def _that_none_stands_for(of_set: Together, weighed: Weighed) -> Together:
    """Return those of a set that explain beside the others nearly what they do by themselves."""
    alone = {one.name: one.log_bayes_factor for one in weighed.ranking}
    taken_up = [one for one in of_set.members if one.log_bayes_factor < RULES.near_if_linear * alone[one.name]]
    return of_set.without({one.name for one in taken_up})


def _try_one_set(
    context: FitContext, checked: Checked, weighed: Weighed, of_set: Together, tried: Tried
) -> tuple[Round, ...]:
    """Fit the effects of a set as a whole; return them as rounds, those with the most evidence first.

    Each has to pass what a single effect has to, in the order of the rounds, with those after it left out where the
    joint fit has the others. One that does not is refused (``tried`` receives it), and the others are fitted again.
    Those that have too little beside a rival go first, the least of them before the others: that takes no further fit.
    One that explains less than nothing without those after it comes last, once: what the model had before has moved in
    the joint fit, as positions do beside a clock, and each makes up for the other. There are no rounds where the set
    has no two effects, or one and next to nothing, or cannot be fitted so: then effects are tried one by one.
    Collective: all ranks of the grid.
    """
    members = tuple(takewhile(_is_told_by_linear_model, of_set.members))
    if len(members) < 2 or _is_first_alone(members):
        return ()
    titles = ", ".join(f"{one.title} (ln BF {one.log_bayes_factor:.4g})" for one in members)
    say(f"  trying together: {titles}", context.grid.is_world_root)
    found, put_off = _fit(context, checked.fitted, members), set[tuple[str, str | None]]()
    while found is not None:
        refused = _least_beside_rivals(context, *found, weighed)
        if refused is None:
            rounds, refused = _one_by_one(context, checked, *found, weighed, of_set)
            if refused is None:
                return rounds
            if refused.is_too_early and refused.candidate.name not in put_off:
                put_off.add(refused.candidate.name)
                found = _last(context, *found, refused.number)
                continue
        say(f"    {refused.candidate.title}: refused: {refused.reason}", context.grid.is_world_root)
        tried.append((refused.candidate, refused.reason))
        if len(found[1]) <= 2:
            return ()
        found = _fit_without(context, *found, refused.number)
    say("    their joint fit does not converge", context.grid.is_world_root)
    return ()


def _is_told_by_linear_model(member: Candidate) -> bool:
    """Whether the linear model says what a member is beside the others.

    It does not of what is picked from a grid: a source beside its place is made up for by several, also by some that
    vary. A fault of the beam's model is told from effects once these are in the model.
    """
    on_grid = member.finding is not None and member.finding.effect.gets_simpler_when_fitted
    return not (on_grid or member.is_about_the_beam)


def _is_first_alone(members: Sequence[Candidate]) -> bool:
    """Whether all others have next to nothing beside the first, which is not linear.

    So much may be what the linear model lacks of the first, and is weighed again once that is in the model.
    """
    first, *others = members
    if first.finding is None or first.finding.effect.linear:
        return False
    return sum(one.log_bayes_factor for one in others) < RULES.near * first.log_bayes_factor


def as_one(rounds: Sequence[Round]) -> Round:
    """Return rounds as one that adds all of them: what would explain all at once has to be better than the whole set.

    Positions of all antennas may stand for a clock that is wrong together with the gain of one of them.
    """
    last, evidences = rounds[-1], [one.candidate.finding.evidence for one in rounds if one.candidate.finding]
    evidence = evidences[-1].with_others(evidences[:-1])
    finding = last.candidate.finding and replace(last.candidate.finding, evidence=evidence)
    total = sum(one.candidate.log_bayes_factor for one in rounds)
    candidate = replace(last.candidate, log_bayes_factor=total, finding=finding)
    members = tuple(one.candidate for one in rounds)
    return replace(last, candidate=candidate, before=rounds[0].before, together=members)


def _fit(
    context: FitContext, before: Fitted, members: Sequence[Candidate]
) -> tuple[Fitted, tuple[Candidate, ...]] | None:
    """Fit all of them jointly, each as it is wanted beside the others; return the fit and those that are.

    None where no fit converges. Collective: all ranks of the grid.
    """
    values = before.values
    for one in members:
        assert one.finding is not None
        values = values.extended(started(context, one.finding, one.finding.evidence.prior_var))
    n_before = len(before.values.active)
    try:
        fitted = fit_patiently(context, values, before)
        for place in range(n_before, len(fitted.values.active)):
            fitted = with_best_variant(context, fitted, place)
        return _as_wanted(context, fitted, tuple(members))
    except BrokenOff:
        return None


def _fit_without(
    context: FitContext, fitted: Fitted, members: Sequence[Candidate], number: int
) -> tuple[Fitted, tuple[Candidate, ...]] | None:
    """Fit the last of the model's effects, all ``members`` of a set, again without the one of a number; as for `_fit`.

    It begins where all of them have been fitted: by the linear model alone others might come back that were taken back
    there. Collective: all ranks of the grid.
    """
    values = fitted.values.without(len(fitted.values.active) - len(members) + number)
    try:
        again = fit_patiently(context, values, fitted)
        return _as_wanted(context, again, (*members[:number], *members[number + 1 :]))
    except BrokenOff:
        return None


def _last(
    context: FitContext, fitted: Fitted, members: tuple[Candidate, ...], number: int
) -> tuple[Fitted, tuple[Candidate, ...]]:
    """Put the one of a number last of a set that has been fitted; as for `_fit`."""
    active, place = fitted.values.active, len(fitted.values.active) - len(members) + number
    values = replace(fitted.values, active=(*active[:place], *active[place + 1 :], active[place]))
    return solved_at(context, values, fitted), (*members[:number], *members[number + 1 :], members[number])


def _as_wanted(
    context: FitContext, fitted: Fitted, left: tuple[Candidate, ...]
) -> tuple[Fitted, tuple[Candidate, ...]] | None:
    """Fit the last of the model's effects, those ``left`` of a set, as each is wanted beside the others; as for `_fit`.

    Raises
    ------
    BrokenOff
        On all ranks, where they cannot be fitted so.
    """
    n_before = len(fitted.values.active) - len(left)

    def kept(places: dict[int, int | None]) -> tuple[Candidate, ...]:
        return tuple(one for number, one in enumerate(left, n_before) if places[number] is not None)

    for _ in range(RULES.most_refits):
        while (cut := leave_out_unphysical(context, fitted, n_before)) is not None:
            fitted, left = fit_patiently(context, cut.values, fitted), kept(cut.places)
        # What has not converged says nothing of what is wanted.
        if not fitted.diagnostics.converged:
            return None
        again = reweigh(context, fitted, range(n_before, len(fitted.values.active)))
        if again is None:
            break
        fitted, left = again.fitted, kept(again.places)
    return (fitted, left) if left and fitted.diagnostics.converged else None


class _Refused(NamedTuple):
    """Which of a set is refused, by its number in it, and why; too early if it is for lack of those after it."""

    number: int
    candidate: Candidate
    reason: str
    is_too_early: bool = False


def _least_beside_rivals(
    context: FitContext, fitted: Fitted, members: Sequence[Candidate], weighed: Weighed
) -> _Refused | None:
    """Return which of a joint fit has the least beside a rival, and too little; None where all have enough.

    Collective: all ranks of the grid.
    """
    settings, n_before = context.problem.job.loop, len(fitted.values.active) - len(members)
    places = range(n_before, len(fitted.values.active))
    own = zip(members, fitted.values.active[n_before:], reconsider_each(context, fitted, places), strict=True)
    candidates = [_with_evidence(member, one.effect, evidence) for member, one, evidence in own]
    rivals = [rivals_of(one, weighed.ranking, settings) for one in candidates]
    beside = least_beside(context, fitted, dict(zip(places, rivals, strict=True)))
    number, (_, reason) = min(enumerate(beside.values()), key=lambda one: one[1].log_bayes_factor)
    return None if reason is None else _Refused(number, candidates[number], reason)


def _one_by_one(
    context: FitContext,
    checked: Checked,
    fitted: Fitted,
    members: Sequence[Candidate],
    weighed: Weighed,
    of_set: Together,
) -> tuple[tuple[Round, ...], _Refused | None]:
    """Add the effects of a joint fit one after the other; return the rounds, or none and the first that is refused.

    Collective: all ranks of the grid.
    """
    n_before, rounds, before = len(checked.fitted.values.active), list[Round](), checked
    for place in range(n_before, len(fitted.values.active)):
        fitted = by_heldout(context, fitted, place)
    whole = check(context, fitted)
    for place, member in enumerate(members, n_before):
        after, is_last = whole, place + 1 == len(fitted.values.active)
        if not is_last:
            # The others stay where they are: left alone, they would make up for what is still to come.
            values = replace(fitted.values, active=fitted.values.active[: place + 1])
            after = check(context, solved_at(context, values, fitted))
        candidate = _as_fitted(context, before.fitted, after.fitted, fitted, place, member)
        told = f"held-out chi^2 {after.score.chi2:.4g}, rms {after.numbers.of_all['rms']:.4g} Jy"
        say(f"    {member.title}: {told} (ln BF {candidate.log_bayes_factor:.4g})", context.grid.is_world_root)
        reason = refusal_of_fit(context, before, after, candidate, whole.fitted)
        if reason is not None:
            too_early = not is_last and candidate.log_bayes_factor < 0
            return (), _Refused(len(rounds), candidate, reason, too_early)
        ranking = weighed.ranking if place == n_before else of_set.in_place_of(member)
        rounds.append(round_of(context, before, after, candidate, ranking))
        before = after
    return _told_together(rounds, of_set), None


def _told_together(rounds: Sequence[Round], of_set: Together) -> tuple[Round, ...]:
    """Return rounds with all effects of their set, those that were fitted with the evidence that they have come to."""
    as_fitted = [one.candidate for one in rounds]
    names = {one.name for one in as_fitted}
    together = (*as_fitted, *(one for one in of_set.members if one.name not in names))
    return tuple(replace(one, together=together) for one in rounds)


def _as_fitted(
    context: FitContext, before: Fitted, after: Fitted, joint: Fitted, place: int, member: Candidate
) -> Candidate:
    """Return an effect with the evidence that it has with those before it, and with the prior of the joint fit.

    Those of all effects add up to that of the set. Collective: all ranks of the grid.
    """
    again = reconsider(context, joint, place)
    gained = rise(context, before, after) - price_of_fitted(context, after)
    return _with_evidence(member, joint.values.active[place].effect, again.with_gain(gained))


def _with_evidence(member: Candidate, effect: Effect, evidence: Evidence) -> Candidate:
    return replace(member, finding=Finding(effect, evidence), log_bayes_factor=evidence.log_bayes_factor)
