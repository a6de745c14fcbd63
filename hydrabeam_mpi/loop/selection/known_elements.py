"""Elements found at places of their own may be errors of what is known: a source, of the catalogue's fluxes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from hydrabeam_mpi.data.observation import BoolArray
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import solved_at
from hydrabeam_mpi.fit.state import Active
from hydrabeam_mpi.loop.attribution.reconsider import reconsider
from hydrabeam_mpi.loop.attribution.score_effects import Finding, attribute
from hydrabeam_mpi.loop.selection.acceptance import Candidate, Checked, Round
from hydrabeam_mpi.loop.selection.physical import rest_of
from hydrabeam_mpi.loop.selection.predictions import check
from hydrabeam_mpi.loop.selection.refits import fit_patiently, rise
from hydrabeam_mpi.loop.selection.trials import round_of, try_effects
from hydrabeam_mpi.terminal.progress import say


def as_known(
    context: FitContext,
    last: Checked,
    rounds: Sequence[Round],
    effects: Sequence[Effect],
    tried: list[tuple[Candidate, str]],
) -> tuple[Round, dict[int, int | None]] | None:
    """Take an element out of its effect where it is more likely an error of what is known.

    A flux that is wrong in the catalogue looks like a source at that place, which has a place to fit besides. Where a
    place agrees with a known one, the two are fitted and compared by their evidence, with the held-out data's density,
    beside all else. Collective: all ranks of the grid. Arguments and what is returned are those of `exchange`.
    """
    fitted = last.fitted
    kinds = {one.kind for one in effects}
    for place in [one.place for one in rounds if one.place is not None]:
        active, std = fitted.values.active[place], fitted.fit.std[place]
        for gone, effect in active.effect.known_elements(context.setup, active.x, std):
            added = _instead(context, last, place, gone, effect, tried) if effect.kind in kinds else None
            if added is not None:
                n, is_all = len(fitted.values.active), rest_of(context, active, gone) is None
                same: dict[int, int | None] = {old: old - (is_all and old > place) for old in range(n + 1)}
                return added, same | ({place: None} if is_all else {})
    return None


def _instead(
    context: FitContext, last: Checked, place: int, gone: BoolArray, effect: Effect, tried: list[tuple[Candidate, str]]
) -> Round | None:
    """Fit an effect instead of some parameters of the one at ``place``; return the round if that is better."""
    active = last.fitted.values.active
    rest, own = rest_of(context, active[place], gone), rest_of(context, active[place], ~gone)
    if own is None:
        return None
    kept = (*active[:place], *([] if rest is None else [rest]), *active[place + 1 :])
    # The others stay where they are: left alone, they would make up for it.
    without = check(context, solved_at(context, replace(last.fitted.values, active=kept), last.fitted))
    (finding,) = attribute(context, without.fitted, [effect]) or (None,)
    if finding is None:
        return None
    say(f"  in the place of one of {own.effect.title}:", context.grid.is_world_root)
    present = _present(context, last, without, own)
    best = try_effects(context, without, [Candidate.of(finding)], tried, present)
    if best is None or best is present:
        return None
    name = own.effect.parameters(context.setup).names[0]
    told = f"{own.effect.title}: {name} taken back, as it is one of the {best.candidate.title}"
    say(f"  {told}", context.grid.is_world_root)
    added = round_of(context, last, best.after, best.candidate, best.ranking)
    return replace(added, revised=(told,), place=len(active))


def _present(context: FitContext, last: Checked, without: Checked, own: Active) -> Round:
    """Tell what there is now as a round that adds it to the model ``without`` it."""
    values = without.fitted.values
    now = fit_patiently(context, replace(values, active=(*values.active, own)), last.fitted)
    evidence = reconsider(context, now)
    risen = evidence.log_bayes_factor - evidence.linear_gain + rise(context, without.fitted, now)
    candidate = replace(Candidate.of(Finding(own.effect, evidence)), log_bayes_factor=risen)
    return round_of(context, without, last, candidate, ())
