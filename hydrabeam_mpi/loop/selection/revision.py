"""What was found is weighed again beside what was found since: narrower, wider, or taken back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hydrabeam_mpi.data.observation import IntArray
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import BrokenOff
from hydrabeam_mpi.fit.state import Active, Fitted
from hydrabeam_mpi.loop.attribution.evidence import Evidence
from hydrabeam_mpi.loop.attribution.reconsider import Known, as_it_is, as_it_may_be, compare_priors
from hydrabeam_mpi.loop.rules import RULES
from hydrabeam_mpi.loop.selection.acceptance import Round
from hydrabeam_mpi.loop.selection.predictions import check
from hydrabeam_mpi.loop.selection.refits import fit_anew, is_same_prior, restarted, rise
from hydrabeam_mpi.loop.selection.refusal import rise_of_rms
from hydrabeam_mpi.terminal.progress import say


@dataclass(frozen=True)
class Revision:
    """An effect of the model that is weighed anew.

    Attributes
    ----------
    place : int
        Among the active effects.
    new : Evidence or None
        With the prior that is the best now; None where the model is better without it.
    gain : float
        By how much that raises ln evidence, beyond what a fit gains in ln(likelihood x prior).
    unchanging : (Effect, ndarray of int), optional
        What it is without what changes in time, if that is better; see `Effect.unchanging`.
    """

    place: int
    new: Evidence | None
    gain: float
    unchanging: tuple[Effect, IntArray] | None = None

    @classmethod
    def left_out(cls, place: int, present: Evidence) -> Revision:
        """Leave the effect at a place out, of which this is the evidence with the prior that it has."""
        return cls(place, None, present.price)


@dataclass(frozen=True)
class Reweighed:
    """A model of which effects were weighed anew.

    Attributes
    ----------
    fitted : Fitted
    places : dict
        Where each active effect is now, by where it was; None where it was left out.
    told : tuple of str
        What became of those that changed.
    is_constant : bool
        Whether something that seemed to vary is constant now.
    """

    fitted: Fitted
    places: dict[int, int | None]
    told: tuple[str, ...]
    is_constant: bool


def reweigh(context: FitContext, fitted: Fitted, places: Sequence[int], newest: int | None = None) -> Reweighed | None:
    """Weigh effects of the model again, each given the others, and refit where another prior is better.

    Groups of parameters (an antenna, a source) and whole effects without which the evidence is higher are left out, but
    for the ``newest``, which has just been found to raise it. None where nothing changes. Collective: all ranks of the
    grid.
    """
    known = Known.of(context, fitted)
    weighed = [_weigh_again(context, fitted, known, place, place == newest) for place in places]
    found = revised_as_far_as_better(context, fitted, [one for one in weighed if one is not None], 0.0)
    return found or _taken_over(context, fitted, known, [place for place in places if place != newest])


def _taken_over(context: FitContext, fitted: Fitted, known: Known, places: Sequence[int]) -> Reweighed | None:
    """Let one effect of the model explain what another does, by what is not in use of it, if that has more evidence.

    Beside the other it has no use for more: a level of refraction is that, or an array that is turned besides.
    Collective: all ranks of the grid.
    """
    active, found = fitted.values.active, list[tuple[float, list[Revision]]]()
    may_grow = [place for place in places if active[place].size < active[place].x.shape[1] <= RULES.most_columns]
    for gone in places:
        others = [place for place in may_grow if place != gone]
        if not others:
            continue
        own, rest = as_it_is(context, fitted, known, gone), known.without(context, gone)
        for other in others:
            place = other - (other > gone)
            present = as_it_is(context, fitted, rest, place)
            needed = present.log_bayes_factor + own.log_bayes_factor
            best = as_it_may_be(context, fitted, rest, place, needed)
            if best is not None:
                revisions = [Revision(other, best, present.price - best.price), Revision.left_out(gone, own)]
                found.append((best.log_bayes_factor - needed, revisions))
    for _, revisions in sorted(found, key=lambda one: -one[0]):
        again = _with_revisions(context, fitted, revisions, 0.0)
        if again is not None:
            return again
    return None


def revised_as_far_as_better(
    context: FitContext, fitted: Fitted, revisions: Sequence[Revision], least: float
) -> Reweighed | None:
    """Refit with all revisions, or where that is no gain with the first alone that is; None where none is.

    Those that promise more come sooner. Collective: all ranks of the grid.
    """
    alone = [[one] for one in sorted(revisions, key=lambda one: -one.gain)] if len(revisions) > 1 else []
    for some in (revisions, *alone) if revisions else ():
        found = _with_revisions(context, fitted, some, least)
        if found is not None:
            return found
    return None


def _with_revisions(
    context: FitContext, fitted: Fitted, revisions: Sequence[Revision], least: float
) -> Reweighed | None:
    """Refit with revisions; None where that lowers ln evidence, or by ``least`` or more for each effect left out.

    Collective: all ranks of the grid.
    """
    active = fitted.values.active
    by_place = {one.place: one for one in revisions}
    kept = [place for place in range(len(active)) if place not in by_place or by_place[place].new is not None]
    values = replace(fitted.values, active=tuple(_revised(context, active[i], by_place.get(i)) for i in kept))
    try:
        again = fit_anew(context, values, fitted)
    except BrokenOff:
        return None
    gain = sum(one.gain for one in revisions) + rise(context, fitted, again)
    n_left_out = len(active) - len(kept)
    if not (gain >= -least * n_left_out and again.diagnostics.converged):
        return None
    told = tuple(_told(active[one.place], one) for one in revisions)
    for line in told:
        change = f"{'rises' if gain >= 0 else 'falls'} by {abs(gain):.4g}"
        say(f"  {line} (ln evidence {change})", context.grid.is_world_root)
    moved: dict[int, int | None] = dict.fromkeys(range(len(active)))
    moved |= {old: new for new, old in enumerate(kept)}
    return Reweighed(again, moved, told, any(one.unchanging for one in revisions))


def revise(context: FitContext, last: Round, n_given: int, is_new: bool = True) -> tuple[Round, dict[int, int | None]]:
    """Weigh all effects found so far again; see `reweigh`. Nothing is revised that raises the held-out rms.

    Collective: all ranks of the grid.

    Parameters
    ----------
    context : FitContext
    last : Round
    n_given : int
        How many effects the job itself has in the model, which stay as they are.
    is_new : bool
        Whether the last effect has just been added, so that it is not left out.

    Returns
    -------
    last : Round
        With what was revised.
    places : dict
        Where each active effect is now, by where it was; None where it was taken back.
    """
    n = len(last.after.fitted.values.active)
    same: dict[int, int | None] = {place: place for place in range(n)}
    # A change of the weights leaves none of the effects as it was when it was found.
    newest = n - 1 if is_new and last.candidate.finding is not None else None
    if all(place == newest for place in range(n_given, n)):
        return last, same
    found = reweigh(context, last.after.fitted, range(n_given, n), newest)
    if found is None:
        return last, same
    after = check(context, found.fitted)
    if (worse := rise_of_rms(last.after, after)) is not None:
        say(f"    refused: {worse}", context.grid.is_world_root)
        return last, same
    last = replace(last, after=after, revised=(*last.revised, *found.told))
    if not found.is_constant:
        return last, found.places
    # Of what was taken for variable in several places there may be fewer that are not.
    last, further = revise(context, last, n_given, is_new)
    return last, {old: None if new is None else further[new] for old, new in found.places.items()}


def _weigh_again(context: FitContext, fitted: Fitted, known: Known, place: int, is_newest: bool) -> Revision | None:
    """Find the best prior of an effect given the others; None where it is the one that it has."""
    one = fitted.values.active[place]
    now = one.prior_var(context.setup)
    best, present = compare_priors(context, fitted, known, place, now)
    # The newest one has just been found to raise it.
    if best.log_bayes_factor < 0 and not is_newest:
        return Revision.left_out(place, present)
    wanted = present if is_same_prior(best.prior_var, now) else max(present, best, key=_log_bayes_factor)
    new, unchanging = wanted, one.effect.unchanging(len(now))
    if unchanging is not None:
        stays = np.isin(np.arange(len(now)), unchanging[1])
        _, level = compare_priors(context, fitted, known, place, np.where(stays, wanted.prior_var, 0.0))
        new = max(wanted, level, key=_log_bayes_factor)
    if new is present:
        return None
    return Revision(place, new, present.price - new.price, unchanging if new is not wanted else None)


def _log_bayes_factor(one: Evidence) -> float:
    return one.log_bayes_factor


def _revised(context: FitContext, active: Active, revision: Revision | None) -> Active:
    if revision is None:
        return active
    assert revision.new is not None
    prior_var = revision.new.prior_var
    if revision.unchanging is not None:
        effect, stays = revision.unchanging
        active, prior_var = replace(active, effect=effect, x=active.x[:, stays]), prior_var[stays]
    return restarted(context, active, prior_var)


def _told(active: Active, revision: Revision) -> str:
    """Say what becomes of an effect."""
    if revision.new is None:
        how = "better" if revision.gain >= 0 else "hardly worse"
        return f"{active.effect.title}: taken back, as the model is {how} without it"
    if revision.unchanging is not None:
        return f"{active.effect.title}: {revision.unchanging[0].title}, as the model is better without what changes"
    wanted = np.flatnonzero(revision.new.prior_var)
    stay, n_used = np.intersect1d(active.used, wanted), len(active.used)
    width = "its prior is re-estimated" if len(stay) == n_used else f"{len(stay)} of {n_used} parameters stay"
    more = f", with {len(wanted) - len(stay)} more" if len(wanted) > len(stay) else ""
    return f"{active.effect.title}: {width}{more}"
