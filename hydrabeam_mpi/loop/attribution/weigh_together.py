"""All effects that have evidence, weighed together: one more pass over the rows, and a search on their whole matrix."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.special import chdtrc

from hydrabeam_mpi.data.observation import FloatArray, IntArray
from hydrabeam_mpi.effects.interface.parameters import Parameters
from hydrabeam_mpi.fit.blocks import CandidateBlock, ColumnBlock
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.state import Fitted
from hydrabeam_mpi.inference.likelihood import Likelihood
from hydrabeam_mpi.inference.significance import SIGNIFICANT_P
from hydrabeam_mpi.loop.attribution.candidate_rows import CachedRowBlocks, candidate_sums, marginal_of
from hydrabeam_mpi.loop.attribution.columns_that_matter import columns_that_matter, has_all_in_use
from hydrabeam_mpi.loop.attribution.evidence import Evidence
from hydrabeam_mpi.loop.attribution.joint_likelihood import Competitor, JointLikelihood
from hydrabeam_mpi.loop.attribution.joint_search import JointSet, search
from hydrabeam_mpi.loop.attribution.limits import Limits
from hydrabeam_mpi.loop.attribution.others import Others
from hydrabeam_mpi.loop.attribution.score_effects import Finding
from hydrabeam_mpi.loop.rules import RULES
from hydrabeam_mpi.mpi import bcast_object, gather_items, together


@dataclass(frozen=True)
class TogetherFound:
    """Effects that explain the residual together.

    Attributes
    ----------
    numbers : tuple of int
        Their places among the findings that they were chosen from, by the evidence that each has beside the others,
        best first.
    beside : tuple of tuple of Finding
        For each of them, itself with that evidence, and then what else could stand in its place.
    log_bayes_factor : float
        Of all of them together.
    explains : bool
        Whether what they leave of the fitted rows may be noise, as far as the model is linear.
    simpler : tuple of TogetherFound
        Others with less evidence and fewer parameters.
    """

    numbers: tuple[int, ...] = ()
    beside: tuple[tuple[Finding, ...], ...] = ()
    log_bayes_factor: float = 0.0
    explains: bool = False
    simpler: tuple[TogetherFound, ...] = ()


def weigh_together(
    context: FitContext, fitted: Fitted, findings: Sequence[Finding], cached: CachedRowBlocks | None = None
) -> TogetherFound:
    """Find the effects that explain the residual together, of those that have evidence by themselves; or none.

    Collective: all ranks of the grid.

    Parameters
    ----------
    context : FitContext
    fitted : Fitted
        Where ``findings`` were weighed.
    findings : sequence of Finding
        Best first.
    cached : CachedRowBlocks, optional
        The rows that they were weighed by.
    """
    least = context.problem.job.loop.min_log_bayes_factor
    wanted = [one for one in findings if one.evidence.log_bayes_factor >= least]
    picked = columns_that_matter(context, fitted, wanted)
    by_channel = _likelihoods(context, fitted, cached, picked)
    limits = Limits.of(context, fitted)

    found = None
    with together(context.grid.world):
        if by_channel is not None:
            competitors = [
                replace(_competitor(context, fitted, one, which), beyond=partial(limits.beyond, one.effect, which))
                for one, which in picked
            ]
            model = Others.of(fitted.values, len(by_channel))
            alone = {
                i: _of_some(one.evidence, which) for i, (one, which) in enumerate(picked) if has_all_in_use(one, which)
            }
            joint = JointLikelihood(by_channel, model, competitors, alone)
            # No set leaves less. An effect that explains no more than a set leaves is not told, nor looked for.
            left = limits.left.chi2 - joint.most_gain() - limits.left.free
            found = _told(picked, with_strong_alone(joint, max(least, left)), findings, *limits.left)
    result: TogetherFound = bcast_object(context.grid.world, found)
    return result


def with_strong_alone(joint: JointLikelihood, least: float) -> JointSet:
    """Search for a set, and for one of effects that are too strong to be what others have that is not linear."""
    every, least_strong = search(joint, least), RULES.not_linear * joint.most_gain()
    if least_strong <= least:
        return every
    strong, known = search(joint, least_strong), [set(one.order) for one in (every, *every.simpler)]
    return every if set(strong.order) in known else replace(every, simpler=(*every.simpler, strong))


def _competitor(context: FitContext, fitted: Fitted, one: Finding, which: IntArray) -> Competitor:
    degenerate = one.effect.degenerate_directions(context.setup)
    inside = ~np.delete(degenerate, which, axis=1).any(axis=1)
    parameters = _some_of(one.effect.parameters(context.setup), which)
    return Competitor(parameters, degenerate[inside][:, which], one.effect.shared, one.effect.is_control_model)


def _some_of(parameters: Parameters, which: IntArray) -> Parameters:
    """Return some of an effect's parameters, which are picked from as many as before."""

    def numbered(numbers: IntArray) -> IntArray:
        return np.unique(numbers[which], return_inverse=True)[1]

    return replace(
        parameters,
        names=tuple(parameters.names[i] for i in which),
        units=tuple(parameters.units[i] for i in which),
        scale=parameters.scale[which],
        element=numbered(parameters.element),
        nonlinear=parameters.nonlinear[which],
        across=None if parameters.across is None else numbered(parameters.across),
        sort=None if parameters.sort is None else parameters.sort[which],
    )


def _likelihoods(
    context: FitContext,
    fitted: Fitted,
    cached: CachedRowBlocks | None,
    picked: Sequence[tuple[Finding, IntArray]],
) -> list[Likelihood] | None:
    """Go through the rows once; on rank 0. Collective: all ranks of the grid."""
    values, found = fitted.values, {}
    blocks: dict[str, ColumnBlock] = {
        f"candidate {number}": CandidateBlock(one.effect, np.zeros(len(one.evidence.prior_var)), only=which)
        for number, (one, which) in enumerate(picked)
    }
    with together(context.grid.world):
        cached = cached or CachedRowBlocks.of(context, fitted.estimate)
    for channel, number in enumerate(context.channels):
        sums = candidate_sums(context, values, cached, channel, blocks, by_pairs=True)
        with together(context.grid.group), context.grid.roots_alone():
            if context.grid.is_group_root:
                marginal = marginal_of(context, fitted, sums, channel, blocks)
                found[number] = marginal.likelihood([*values.blocks, *blocks])
    by_channel = gather_items(context.grid.world, found)
    return None if by_channel is None else list(by_channel.values())


def _told(
    picked: Sequence[tuple[Finding, IntArray]],
    chosen: JointSet,
    findings: Sequence[Finding],
    total: float,
    free: float,
) -> TogetherFound:
    """Return what was found in terms of whole effects; ``free`` of chi^2, ``total``, are noise without any."""
    unexplained = free
    free -= 0.5 * sum(chosen.beside[m][m].effective_parameters for m in chosen.order)
    left = max(total - chosen.gain, 0.0)
    # What the linear model leaves may be told by any of those that explain less than that.
    order = [m for m in chosen.order if chosen.beside[m][m].log_bayes_factor > left - free]

    def finding(number: int, evidence: Evidence) -> Finding:
        one, which = picked[number]
        return Finding(one.effect, _of_all(evidence, which, one.evidence))

    beside = [[finding(i, found) for i, found in chosen.beside[m].items()] for m in order]
    places = [next(i for i, one in enumerate(findings) if one is picked[m][0]) for m in order]
    is_noise = free > 0 and bool(chdtrc(2 * free, 2 * left) >= SIGNIFICANT_P)
    simpler = tuple(_told(picked, one, findings, total, unexplained) for one in chosen.simpler)
    return TogetherFound(tuple(places), tuple(map(tuple, beside)), chosen.log_bayes_factor, is_noise, simpler)


def _of_some(evidence: Evidence, which: IntArray) -> Evidence:
    """Return the evidence for an effect in terms of some of its parameters, all that are in use among them."""
    prior_var, alone = evidence.prior_var[which], evidence.alone[which]
    return replace(evidence, prior_var=prior_var, x=evidence.x[:, which], std=evidence.std[:, which], alone=alone)


def _of_all(evidence: Evidence, which: IntArray, by_itself: Evidence) -> Evidence:
    """Return the evidence for an effect of which some parameters were weighed, the others at zero.

    What each element gains alone is as it was with nothing beside the effect.
    """
    n = len(by_itself.prior_var)
    prior_var: FloatArray = np.zeros(n)
    x, std = np.zeros((2, len(evidence.x), n))
    prior_var[which], x[:, which], std[:, which] = evidence.prior_var, evidence.x, evidence.std
    return replace(evidence, prior_var=prior_var, x=x, std=std, alone=by_itself.alone)
