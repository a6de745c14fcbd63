"""Which effect the residual comes from: the evidence for each, with beam and all other parameters marginalised."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray, IntArray
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.fit.blocks import CandidateBlock
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.state import Fitted, Values
from hydrabeam_mpi.inference.likelihood import Likelihood
from hydrabeam_mpi.loop.attribution.beside import Beside, KnownModel
from hydrabeam_mpi.loop.attribution.candidate_rows import CachedRowBlocks, likelihoods
from hydrabeam_mpi.loop.attribution.evidence import Evidence, evidence_of, find_evidence, find_possible
from hydrabeam_mpi.loop.attribution.limits import Limits
from hydrabeam_mpi.loop.attribution.scan import pick
from hydrabeam_mpi.mpi import bcast_object, gather_items, scatter_objects, together


@dataclass(frozen=True)
class Finding:
    """An effect and what the data say of it.

    Attributes
    ----------
    effect : Effect
        With its candidates picked, where it is scanned.
    evidence : Evidence
    """

    effect: Effect
    evidence: Evidence

    @property
    def kind(self) -> str:
        """The effect's name."""
        return self.effect.kind


def attribute(
    context: FitContext, fitted: Fitted, effects: Sequence[Effect], cached: CachedRowBlocks | None = None
) -> list[Finding]:
    """Weigh effects that are not part of the model, best first.

    Collective: all ranks of the grid.

    Parameters
    ----------
    context : FitContext
    fitted : Fitted
    effects : list of Effect
        Those that these data can carry.
    cached : CachedRowBlocks, optional
        The fitted rows as blocks, where they are at hand.
    """
    values = fitted.values
    with together(context.grid.world):
        cached = cached or CachedRowBlocks.of(context, fitted.estimate)
    picked = pick(context, fitted, cached, effects)
    picked = [effect for effect in picked if _has_more(context, values, effect)]
    told = _told_of_each(context, fitted, cached, picked)
    # What all channels may have alike has the same columns, so that the other form costs no further sums.
    alike = _in_all_channels(context, picked)
    forms, told_of_forms = [*picked, *alike.values()], None if told is None else [*told, *(told[k] for k in alike)]
    evidence = _weigh_all(context, values, forms, told_of_forms, Limits.of(context, fitted))
    findings = None
    if evidence is not None:
        findings = [Finding(effect, one) for effect, one in zip(forms, evidence, strict=True)]
        for number, other in zip(alike, findings[len(picked) :], strict=True):
            findings[number] = max(findings[number], other, key=lambda one: one.evidence.log_bayes_factor)
        findings = sorted(findings[: len(picked)], key=lambda one: -one.evidence.log_bayes_factor)
    result: list[Finding] = bcast_object(context.grid.world, findings)
    return result


def weigh_as_they_are(context: FitContext, fitted: Fitted, effects: Sequence[Effect]) -> list[Evidence]:
    """Weigh effects with the elements that they have, and none else, in the order in which they are given.

    Collective: all ranks of the grid.
    """
    with together(context.grid.world):
        cached = CachedRowBlocks.of(context, fitted.estimate)
    told = _told_of_each(context, fitted, cached, effects)
    evidence = _weigh_all(context, fitted.values, effects, told, Limits.of(context, fitted))
    result: list[Evidence] = bcast_object(context.grid.world, evidence)
    return result


def _told_of_each(
    context: FitContext, fitted: Fitted, cached: CachedRowBlocks, effects: Sequence[Effect]
) -> list[list[Beside]] | None:
    """Return what each channel says of each effect around zero; None off rank 0. Collective: all ranks of the grid."""
    candidates = {
        f"candidate {number}": CandidateBlock(effect, np.zeros(len(effect.parameters(context.setup))))
        for number, effect in enumerate(effects)
    }
    by_name = likelihoods(context, fitted, cached, candidates)
    return None if by_name is None else list(by_name.values())


def _in_all_channels(context: FitContext, effects: Sequence[Effect]) -> dict[int, Effect]:
    """Return the forms in which effects are the same in all channels, by their numbers; none with one channel."""
    if context.setup.observation.Nfreqs < 2:
        return {}
    forms = ((number, effect.same_in_all_channels()) for number, effect in enumerate(effects))
    return {number: form for number, form in forms if form is not None}


def attribute_sizes(context: FitContext, fitted: Fitted, sizes: Sequence[Effect]) -> list[Finding]:
    """Weigh an effect with more and more parameters, each with those of the one before it first.

    The rows are summed once, for the largest. Collective: all ranks of the grid.
    """
    with together(context.grid.world):
        cached = CachedRowBlocks.of(context, fitted.estimate)
    n_params = [len(effect.parameters(context.setup)) for effect in sizes]
    candidate = CandidateBlock(sizes[-1], np.zeros(n_params[-1]))
    by_name, told = likelihoods(context, fitted, cached, {"candidate": candidate}), None
    if by_name is not None:
        told = [[one.of_first(n) for one in by_name["candidate"]] for n in n_params]
    evidence = _weigh_all(context, fitted.values, sizes, told, Limits.of(context, fitted))
    findings = None if evidence is None else list(map(Finding, sizes, evidence))
    result: list[Finding] = bcast_object(context.grid.world, findings)
    return result


def _weigh_all(
    context: FitContext,
    values: Values,
    effects: Sequence[Effect],
    likelihoods_of: Sequence[list[Beside]] | None,
    limits: Limits,
) -> list[Evidence] | None:
    """Weigh effects, shared out among the ranks, from what channels say of each, which is known on rank 0.

    On rank 0 alone. Collective: all ranks of the grid.
    """
    world, shares = context.grid.world, None
    if likelihoods_of is not None:
        # Those with the most parameters, which take longest, first.
        order = sorted(enumerate(likelihoods_of), key=lambda one: -len(one[1][0].own.score))
        shares = [order[rank :: world.size] for rank in range(world.size)]
    mine: list[tuple[int, list[Beside]]] = scatter_objects(world, shares)
    weighed = {}
    with together(world):
        model = KnownModel.of(values, mine[0][1]) if mine else None
        for number, told in mine:
            left = model.left(told, effects[number].shared) if model else []
            own = [one.own for one in told]
            weighed[number] = weigh(context, values, effects[number], left, own, limits=limits)
    by_number = gather_items(world, weighed)
    return None if by_number is None else list(by_number.values())


def taken(values: Values, effect: Effect) -> IntArray:
    """Return the parameters of an effect that are part of the model already."""
    same = [one.used for one in values.active if one.kind == effect.kind and one.effect.describe() == effect.describe()]
    return np.concatenate([np.zeros(0, dtype=int), *same])


def _has_more(context: FitContext, values: Values, effect: Effect) -> bool:
    """Whether an effect has parameters that are not part of the model yet."""
    return len(taken(values, effect)) < len(effect.parameters(context.setup))


def weigh(
    context: FitContext,
    values: Values,
    effect: Effect,
    left: list[Likelihood],
    by_channel: list[Likelihood],
    prior_var: FloatArray | None = None,
    limits: Limits | None = None,
) -> Evidence:
    """Weigh one effect over all channels, with the active effects marginalised and without what is part of them.

    ``left`` is what is said of it with these marginalised, of each channel or of all, and ``by_channel`` what each says
    with none; the effect comes last there. With ``prior_var``, (n_params,), by that prior; else by the one that has the
    most evidence, of what can be within ``limits``.
    """
    parameters = effect.parameters(context.setup)
    scale = parameters.scale.copy()
    scale[taken(values, effect)] = 0.0
    parameters, degenerate = replace(parameters, scale=scale), effect.degenerate_directions(context.setup)
    if prior_var is not None:
        evidence = evidence_of(left, parameters, prior_var, degenerate)
    elif limits is not None:
        beyond = partial(limits.beyond, effect, np.arange(len(parameters)))
        evidence = find_possible(left, parameters, degenerate, beyond)
    else:
        evidence = find_evidence(left, parameters, degenerate)
    return replace(evidence, absorbed=_absorbed(evidence, by_channel)) if values.active else evidence


def _absorbed(evidence: Evidence, by_channel: list[Likelihood]) -> float:
    """Return how much of an effect's signature the beam takes up, whatever the active effects take besides."""
    own = slice(-evidence.x.shape[1], None)
    seen = present = 0.0
    for one, x in zip(by_channel, np.broadcast_to(evidence.x, (len(by_channel), evidence.x.shape[1])), strict=True):
        seen += float(x @ one.information[own, own] @ x)
        present += float(x @ one.signal[own, own] @ x)
    return float(np.clip(1 - seen / present, 0.0, 1.0)) if present > 0 else 0.0
