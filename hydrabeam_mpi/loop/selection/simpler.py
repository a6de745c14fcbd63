"""Elements that may be something with fewer parameters: sources of the catalogue, gains that a delay makes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hydrabeam_mpi.data.observation import BoolArray
from hydrabeam_mpi.effects.interface.effect import Effect, Parameters
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.state import Active, Fitted, Values
from hydrabeam_mpi.fit.step import solved_at
from hydrabeam_mpi.loop.attribution.evidence import Evidence
from hydrabeam_mpi.loop.attribution.reconsider import reconsider
from hydrabeam_mpi.loop.attribution.score_effects import Finding
from hydrabeam_mpi.loop.selection.acceptance import Candidate, Checked, Round
from hydrabeam_mpi.loop.selection.exchange import places_without
from hydrabeam_mpi.loop.selection.physical import rest_of
from hydrabeam_mpi.loop.selection.predictions import check
from hydrabeam_mpi.loop.selection.refits import fit_patiently, rise
from hydrabeam_mpi.loop.selection.trials import round_of, try_effects
from hydrabeam_mpi.mpi import bcast_object
from hydrabeam_mpi.terminal.progress import say


def simplified(
    context: FitContext,
    last: Checked,
    rounds: Sequence[Round],
    effects: Sequence[Effect],
    tried: list[tuple[Candidate, str]],
) -> tuple[Round, dict[int, int | None]] | None:
    """Take elements out of their effect that are more likely something simpler.

    A flux that is wrong in the catalogue looks like a source at that place, which has a place to fit besides; a delay
    looks like gains, which every channel has for itself. From zero the simpler effect may be too far for a linear
    model, as a delay of many turns is, so that it was not found at once. The two are fitted and compared by their
    evidence, with the held-out data's density, beside all else: what has more parameters has to have as much more as
    the job asks of a finding. Collective: all ranks of the grid. Arguments and what is returned are those of
    `exchange`.
    """
    fitted, kinds = last.fitted, {one.kind for one in effects}
    for place in [one.place for one in rounds if one.place is not None]:
        active, std = fitted.values.active[place], fitted.fit.std[place]
        # All ranks go the same way, whatever their processors make of a sum.
        found = bcast_object(context.grid.world, active.effect.simpler_elements(context.setup, active.x, std))
        for gone, effect, x in found:
            # What jumps and is zero at most times is nothing that is constant.
            if effect.kind not in kinds or not gone[active.used].any() or not x.any():
                continue
            # What it is worth only its fit tells, which begins where the other has ended. It is simpler even with as
            # many parameters, as what is constant than what jumps at a time that was picked: weighed, none count yet.
            size = Evidence(0.0, x**2, x[np.newaxis], 0.0, 0.0, 0.0, int(np.count_nonzero(x)), 0.0)
            added = _instead(context, last, place, gone, Finding(effect, size), tried)
            if added is not None:
                n = len(fitted.values.active)
                return added, places_without(place, n) if gone[active.used].all() else {
                    old: old for old in range(n + 1)
                }
    return None


def _instead(
    context: FitContext,
    last: Checked,
    place: int,
    gone: BoolArray,
    finding: Finding,
    tried: list[tuple[Candidate, str]],
) -> Round | None:
    """Fit what was found instead of some parameters of the effect at ``place``; return the round if it is better."""
    active = last.fitted.values.active
    own, rest = _part(context, active[place], gone), _rest(context, active[place], gone)
    names = own.effect.parameters(context.setup).names
    named = f"{names[own.used[0]]}{f' and {own.size - 1} more' if own.size > 1 else ''}"
    say(f"  in the place of {named}:", context.grid.is_world_root)
    left = (*active[:place], *([rest] if rest else []), *active[place + 1 :])
    kept = replace(last.fitted.values, active=left)
    # The others stay where they are: left alone, they would make up for it.
    without = check(context, solved_at(context, kept, last.fitted))
    present = _present(context, last, without, own, finding.effect)
    begun = _begun(context, kept, last.fitted, finding)
    candidate = replace(Candidate.of(finding), log_bayes_factor=present.candidate.log_bayes_factor, begun=begun)
    best = try_effects(context, without, [candidate], tried, present)
    if best is None or best is present:
        return None
    told = f"{own.effect.title}: {named} taken back, as {best.candidate.title} explain as much with less"
    say(f"  {told}", context.grid.is_world_root)
    added = round_of(context, last, best.after, best.candidate, best.ranking)
    return replace(added, revised=(told,), place=len(active))


def _begun(context: FitContext, kept: Values, last: Fitted, finding: Finding) -> Fitted | None:
    """Return where the simpler effect is to be what the other was; None where a fit begins there anyway.

    What is seen by the beam is small at first in any other fit, as it is not known how the beam gives way. Here it is.
    And what the linear model finds may stand for something else, such as for logarithms of gains, which these are.
    Collective: all ranks of the grid.
    """
    effect, x = finding.effect, finding.evidence.x
    start = Active.start(effect, context.setup, finding.evidence.prior_var, x)
    begins_there = not start.adds and np.array_equal(effect.begun(context.setup, x), x)
    return None if begins_there else solved_at(context, kept.extended(start), last, keep=start.adds)


def _rest(context: FitContext, one: Active, gone: BoolArray) -> Active | None:
    """Return an effect without some of its parameters; None where none of those left is in use.

    A source that is told to be something else is none of its sources any more. Antennas are its own to have as before.
    """
    if one.effect.unphysical:
        return rest_of(context, one, gone)
    rest = _part(context, one, ~gone)
    return rest if rest.size else None


def _part(context: FitContext, one: Active, which: BoolArray) -> Active:
    """Return an effect with some of its parameters in use, (n_params,)."""
    prior_var = np.where(which, one.prior_var(context.setup), 0.0)
    return Active.start(one.effect, context.setup, prior_var, np.where(which, one.x, 0.0))


def _present(context: FitContext, last: Checked, without: Checked, own: Active, simpler: Effect) -> Round:
    """Tell what there is now as a round that adds it to the model ``without`` it.

    Places are weighed beside all else by the linear model of what is there, at the price of picking one of so many. How
    much nearer the data tell what the ``simpler`` effect does not have is Occam's factor, of prior over posterior
    width, which that is spared. What it says beyond that is a claim of its own, which has to have the evidence that the
    job asks for.
    """
    values = without.fitted.values
    now = fit_patiently(context, replace(values, active=(*values.active, own)), last.fitted)
    evidence = reconsider(context, now)
    parameters, spared = own.effect.parameters(context.setup), _kinds(simpler.parameters(context.setup))
    placed = [parameters.nonlinear[i] and _kind(parameters.names[i]) not in spared for i in own.used.tolist()]
    narrower = (own.prior.of(0).std() / now.fit.std[-1][0, own.used])[placed]
    risen = rise(context, without.fitted, now) - evidence.price
    evidence = replace(evidence, effective_parameters=evidence.effective_parameters + len(narrower))
    candidate = Candidate.of(Finding(own.effect, evidence))
    beyond = context.problem.job.loop.min_log_bayes_factor
    candidate = replace(candidate, log_bayes_factor=risen - float(np.sum(np.log(narrower))) - beyond)
    return round_of(context, without, last, candidate, ())


def _kinds(parameters: Parameters) -> set[str]:
    """Return what an effect's nonlinear parameters are, whatever they are of."""
    return {_kind(name) for name, placed in zip(parameters.names, parameters.nonlinear, strict=True) if placed}


def _kind(name: str) -> str:
    return name.rpartition(": ")[2]
