"""What is taken back once nothing more is found: what is faint, unphysical, not the same in all parts, or explained."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from hydrabeam_mpi.effects.interface.reweighting import ReweightingFit
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import BrokenOff
from hydrabeam_mpi.fit.state import Active, Fitted, Reweighted
from hydrabeam_mpi.loop.attribution.constancy import Constancy
from hydrabeam_mpi.loop.attribution.parts import Affected, ask_constancy
from hydrabeam_mpi.loop.attribution.reconsider import Known, compare_priors
from hydrabeam_mpi.loop.attribution.score_noise import WeightsFound, refit_reweighting
from hydrabeam_mpi.loop.rules import RULES
from hydrabeam_mpi.loop.selection.acceptance import Round
from hydrabeam_mpi.loop.selection.physical import leave_out_unphysical
from hydrabeam_mpi.loop.selection.predictions import check
from hydrabeam_mpi.loop.selection.refits import fit_patiently
from hydrabeam_mpi.loop.selection.refusal import margin_of_parts, refusal_by_parts
from hydrabeam_mpi.loop.selection.revision import Revision, revised_as_far_as_better
from hydrabeam_mpi.terminal.progress import say

Taken = tuple[Round, dict[int, int | None], dict[int, tuple[Constancy, ...]]]


def take_back_faint(context: FitContext, last: Round, n_given: int) -> Taken:
    """Take back effects that beside all others have less evidence than the job asks of a finding; see `take_back`.

    They had enough when they were found, beside fewer others or another prior of the beam. Collective: all ranks of the
    grid.
    """
    fitted, least = last.after.fitted, context.problem.job.loop.min_log_bayes_factor
    active, known, faint = fitted.values.active, Known.of(context, fitted), []
    for place in range(n_given, len(active)):
        now = active[place].prior_var(context.setup)
        best, present = compare_priors(context, fitted, known, place, now)
        if best.log_bayes_factor < least:
            faint.append(Revision.left_out(place, present))
    found = revised_as_far_as_better(context, fitted, faint, least)
    if found is None:
        return last, {place: place for place in range(len(active))}, {}
    last = replace(last, after=check(context, found.fitted), revised=(*last.revised, *found.told))
    return last, found.places, {}


def take_back_unphysical(context: FitContext, last: Round, n_given: int) -> Taken:
    """Take back what is unphysical beside what was found since; see `take_back`. Collective: all ranks of the grid."""
    fitted, told = last.after.fitted, last.revised
    places: dict[int, int | None] = {place: place for place in range(len(fitted.values.active))}
    while found := leave_out_unphysical(context, fitted, n_given, by_likelihood=True):
        without = fit_patiently(context, found.values, fitted)
        for line in found.told:
            say(f"  {line}", context.grid.is_world_root)
        fitted, told = without, (*told, *found.told)
        places = {old: None if now is None else found.places[now] for old, now in places.items()}
    if fitted is not last.after.fitted:
        last = replace(last, after=check(context, fitted), revised=told)
    return last, places, {}


def take_back(context: FitContext, last: Round, n_given: int) -> Taken:
    """Take back the effect that is the least the same in all parts of the data; see `refusal_by_parts`.

    Collective: all ranks of the grid. Not before nothing more is found: while something else is not in the model yet,
    what is true spreads as well, and has elements beside it (sources, antennas) that stand for the rest. So it does
    beside what is not true: others are asked again without that.

    Parameters
    ----------
    context : FitContext
    last : Round
    n_given : int
        How many effects the job itself has in the model, which stay as they are.

    Returns
    -------
    last : Round
        Fitted without what was taken back.
    places : dict
        Where each active effect is now, by where it was; None where it was taken back.
    constancy : dict
        What was found of each that was asked, by where it was.
    """
    fitted = last.after.fitted
    active = fitted.values.active
    affected = Affected.of(last.after.remains, context.setup.observation)
    asked = as_one_of_parts(active, ask_constancy(context, fitted, range(n_given, len(active)), affected))
    settings = context.problem.job.loop
    found = {place: refusal_by_parts(one, settings) for place, one in asked.items()}
    refused = [place for place, why in found.items() if why is not None]
    worst = min(refused, key=lambda place: margin_of_parts(asked[place], settings), default=-1)
    gone = {place: found[place] for place in refused if place == worst or _are_parts(active[place], active[worst])}
    kept = [place for place in range(len(active)) if place not in gone]
    places: dict[int, int | None] = dict.fromkeys(range(len(active)))
    places |= {old: new for new, old in enumerate(kept)}
    if not gone:
        return last, places, asked
    told = [f"{active[place].effect.title}: taken back, as {why}" for place, why in gone.items()]
    for line in told:
        say(f"  {line}", context.grid.is_world_root)
    values = replace(fitted.values, active=tuple(active[place] for place in kept))
    after = check(context, fit_patiently(context, values, fitted))
    return replace(last, after=after, revised=(*last.revised, *told)), places, asked


def _are_parts(one: Active, two: Active) -> bool:
    """Whether both are parts of what comes in parts, of which one and the same was found."""
    return one.effect.comes_in_parts and (one.kind, one.effect.law) == (two.kind, two.effect.law)


def as_one_of_parts(
    active: Sequence[Active], asked: Mapping[int, tuple[Constancy, ...]]
) -> dict[int, tuple[Constancy, ...]]:
    """Return what was found of each effect, where parts of what comes in parts have what was found of all together.

    Of the flux below the end of a catalogue, or of diffuse emission, the last part may be too faint to be the same
    everywhere; without it the others are not, as what it stood for is left to them.
    """
    together: dict[tuple[str, str], list[Constancy]] = {}
    for place, answers in asked.items():
        together.setdefault((active[place].kind, active[place].effect.law), []).extend(answers)

    def of_all(place: int) -> tuple[Constancy, ...]:
        effect = active[place].effect
        by_division: dict[str, list[Constancy]] = {}
        for one in together[active[place].kind, effect.law]:
            by_division.setdefault(one.between, []).append(one)
        return tuple(map(_sum_of, by_division.values())) if effect.comes_in_parts else asked[place]

    return {place: of_all(place) for place in asked}


def _sum_of(answers: Sequence[Constancy]) -> Constancy:
    """Add up what independent parts say; they differ by as much as the one that tells most does."""
    return replace(
        max(answers, key=lambda one: one.expected),
        log_bayes_factor=sum(one.log_bayes_factor for one in answers),
        expected=sum(one.expected for one in answers),
        expected_by_noise=sum(one.expected_by_noise for one in answers),
    )


def beside_noise(context: FitContext, last: Round, n_given: int) -> tuple[Round, dict[str, WeightsFound]]:
    """Tell changes of the weights beside noise that were told beside larger residuals, where that is all there is now.

    Collective: all ranks of the grid.

    Parameters
    ----------
    context : FitContext
    last : Round
        Just accepted.
    n_given : int
        How many changes of the weights the job itself has in the model, which stay.

    Returns
    -------
    last : Round
        Fitted with them.
    found : dict of str to WeightsFound
        By their kinds.
    """
    fitted, least = last.after.fitted, context.problem.job.loop.min_log_bayes_factor
    reweighted, found = list(fitted.values.reweighted), {}
    for place, one in enumerate(reweighted[n_given:], n_given):
        if not one.change.at_own_level:
            continue
        fit = refit_reweighting(context, fitted, one.change)
        if fit.log_bayes_factor >= least and not _is_same(one, fit):
            found[one.change.kind] = WeightsFound(one.change.beside_noise, fit, Fitted())
            reweighted[place] = Reweighted(one.change.beside_noise, fit.x, fit.std)
    if found:
        values = replace(fitted.values, reweighted=tuple(reweighted))
        try:
            last = replace(last, after=check(context, fit_patiently(context, values, fitted)))
        except BrokenOff:
            return last, {}
    return last, found


def _is_same(one: Reweighted, fit: ReweightingFit) -> bool:
    """Whether a change is told beside noise already, and does and says the same as it has been fitted now."""
    is_beside_noise = one.change.describe() == one.change.beside_noise.describe()
    does_same = np.array_equal(one.change.is_told(one.x), one.change.is_told(fit.x))
    says_same = bool(np.all((fit.std == 0) | (np.abs(fit.x - one.x) <= RULES.decided_sigmas * fit.std)))
    return is_beside_noise and does_same and says_same


def take_back_weights(context: FitContext, last: Round, n_given: int) -> tuple[Round, frozenset[str]]:
    """Take back changes of the weights that have too little evidence beside what was found since.

    Collective: all ranks of the grid. A residual with structure may look like larger noise, or like rows far out, until
    what it comes from is part of the model.

    Parameters
    ----------
    context : FitContext
    last : Round
    n_given : int
        How many changes of the weights the job itself has in the model, which stay.

    Returns
    -------
    last : Round
        Fitted without what was taken back.
    gone : frozenset of str
        The kinds of these.
    """
    fitted, least = last.after.fitted, context.problem.job.loop.min_log_bayes_factor
    changes = [one.change for one in fitted.values.reweighted[n_given:]]
    left = {one.kind: refit_reweighting(context, fitted, one).log_bayes_factor for one in changes}
    gone = frozenset(kind for kind, evidence in left.items() if evidence < least)
    if not gone:
        return last, gone
    told = [
        f"{one.title}: taken back, as its log Bayes factor is {left[one.kind]:.4g} beside what was found since"
        for one in changes
        if one.kind in gone
    ]
    for line in told:
        say(f"  {line}", context.grid.is_world_root)
    kept = tuple(one for one in fitted.values.reweighted if one.change.kind not in gone)
    after = check(context, fit_patiently(context, replace(fitted.values, reweighted=kept), fitted))
    return replace(last, after=after, revised=(*last.revised, *told)), gone
