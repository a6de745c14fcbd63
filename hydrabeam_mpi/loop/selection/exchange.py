"""Effects that were chosen before others were known: another may stand in their place beside what was found since."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.step import solved_at
from hydrabeam_mpi.loop.attribution.evidence import Evidence
from hydrabeam_mpi.loop.attribution.reconsider import reconsider
from hydrabeam_mpi.loop.attribution.score_effects import Finding, attribute
from hydrabeam_mpi.loop.rules import RULES
from hydrabeam_mpi.loop.selection.acceptance import Candidate, Checked, Round, is_near
from hydrabeam_mpi.loop.selection.predictions import check
from hydrabeam_mpi.loop.selection.prior_widths import Adapted
from hydrabeam_mpi.loop.selection.refits import rise
from hydrabeam_mpi.loop.selection.refusal import rise_of_rms
from hydrabeam_mpi.loop.selection.trials import round_of, try_effects
from hydrabeam_mpi.terminal.progress import say


def exchange(
    context: FitContext,
    last: Checked,
    rounds: Sequence[Round],
    effects: Sequence[Effect],
    tried: list[tuple[Candidate, str]],
    only_more: bool = False,
    adapted: Sequence[Adapted] = (),
) -> tuple[Round, dict[int, int | None]] | None:
    """Give the place of one effect to another that came near it when it was chosen, if that is better now.

    While something else is missing, an effect with many parameters may take up a part of that and so come before the
    right one. A beam whose prior is too narrow lacks something as well. So each effect since which another was found,
    or other widths of that prior, is left out, and those that had come near are weighed and fitted beside all the
    others, as in any round. The best of them is taken if it has more evidence, with the held-out data's density, than
    the effect that it replaces, and their rms does not rise. An effect is asked once less is left of the fitted data
    than was explained since, or after other widths nothing: before that it may still have taken up what is missing.

    Collective: all ranks of the grid.

    Parameters
    ----------
    context : FitContext
    last : Checked
    rounds : sequence of Round
        So far.
    effects : sequence of Effect
        To look for.
    tried : list
        Receives what was refused, as for `try_effects`.
    only_more : bool
        Whether only those are fitted that have more evidence than the one that is there by the linear model already.
    adapted : sequence of Adapted
        What was decided of the widths of the beam's prior so far.

    Returns
    -------
    Round, dict or None
        The exchange as a round, and where each active effect is now, by where it was; None where there is none.
    """
    for number, found in enumerate(rounds):
        if found.place is None:
            continue
        is_asked = not all(one.revoked for one in rounds[number + 1 :]) and _is_mostly_explained(context, found, last)
        has_other_widths = any(one.is_of_widths and one.n_rounds > number for one in adapted)
        is_asked = is_asked or (has_other_widths and last.remains.consistent)
        near = _near(found, last, effects) if is_asked else []
        better = _better_than(context, last, found, near, tried, only_more) if near else None
        if better is not None:
            return better, places_without(found.place, len(last.fitted.values.active))
    return None


def _is_mostly_explained(context: FitContext, found: Round, last: Checked) -> bool:
    """Whether what was found after an effect explains more of the fitted data than is left. Collective: all ranks."""
    then, now = (context.over_channels(one.fitted.diagnostics.train_chi2) for one in (found.after, last))
    return then - now > now - context.setup.observation.Nfreqs


def _near(found: Round, last: Checked, effects: Sequence[Effect]) -> list[Effect]:
    """Return the effects that came near one when it was chosen.

    Laws in time of a constant effect are no rivals of it: they are looked for beside it, in every round.
    """
    own = found.candidate
    # All by the linear model: a fit may raise the evidence of what was chosen several times.
    chosen = next((one for one in found.ranking if one.name == own.name), own)
    least = RULES.near_if_linear * chosen.log_bayes_factor
    names = {one.name for one in found.ranking if one.finding is not None and one.log_bayes_factor > least}
    names -= {one for one in names if one == own.name or (one[0] == own.kind and own.law == Effect.law)}
    # What explains the data together with it was weighed beside it, if it was added as well.
    names -= {one.name for one in found.together} & {(one.kind, one.effect.law) for one in last.fitted.values.active}
    return [one for one in effects if (one.kind, one.law) in names]


def _better_than(
    context: FitContext,
    last: Checked,
    found: Round,
    near: Sequence[Effect],
    tried: list[tuple[Candidate, str]],
    only_more: bool,
) -> Round | None:
    """Fit what came near an effect in its place; return the best if it is better. Collective: all ranks of the grid."""
    assert found.place is not None
    active = last.fitted.values.active
    own = reconsider(context, last.fitted, found.place)
    rivals = in_place_of(context, last, found.place, own, near)
    if only_more:
        rivals = [one for one in rivals if one.log_bayes_factor > own.log_bayes_factor]
    if not rivals:
        return None
    title = active[found.place].effect.title
    told = f"  in the place of {title} (ln BF {own.log_bayes_factor:.4g}), beside what was found since:"
    say(told, context.grid.is_world_root)
    # The others stay where they are: left alone, they would make up for it.
    without = check(context, solved_at(context, last.fitted.values.without(found.place), last.fitted))
    risen = rise(context, without.fitted, last.fitted) - own.linear_gain
    now = replace(Candidate.of(Finding(active[found.place].effect, own)), log_bayes_factor=own.log_bayes_factor + risen)
    present = replace(found, candidate=now, before=without, after=last, together=())
    ranking = [replace(one, log_bayes_factor=one.log_bayes_factor + risen) for one in rivals]
    best = try_effects(context, without, ranking, tried, present)
    if best is None or best is present:
        return None
    if rise_of_rms(last, best.after) is not None:
        return None
    told = f"{title}: taken back, as {best.candidate.title} explain more in its place beside what was found since"
    say(f"  {told}", context.grid.is_world_root)
    added = round_of(context, last, best.after, best.candidate, best.ranking)
    return replace(added, revised=(told,), place=len(active))


def in_place_of(
    context: FitContext, last: Checked, place: int, own: Evidence, near: Sequence[Effect]
) -> list[Candidate]:
    """Return those effects that come near the one at a place, in that place; the best first.

    ``own`` is what the linear model of the fit says of the one that is there. It is asked of the others in the same
    way: with beams and all else linearised where they are, and what the one explains in the residual again. Solved for
    without it the beams would be far from there, and any effect would seem to explain much of that.
    Collective: all ranks of the grid.
    """
    there = solved_at(context, last.fitted.values.without(place), last.fitted, keep=True)
    found = list(map(Candidate.of, attribute(context, there, near)))
    return [one for one in found if is_near(one, own.log_bayes_factor)]


def places_without(gone: int, n: int) -> dict[int, int | None]:
    """Return where each of ``n`` active effects is once one is gone, and the one that comes after them."""
    places: dict[int, int | None] = {place: place - (place > gone) for place in range(n + 1)}
    return places | {gone: None}
