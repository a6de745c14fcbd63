"""What is part of the model is weighed again where it has been fitted, given all else that is part of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.fit.blocks import CandidateBlock
from hydrabeam_mpi.fit.equations import BEAM
from hydrabeam_mpi.fit.gauss_newton import FitContext
from hydrabeam_mpi.fit.marginal import Marginal
from hydrabeam_mpi.fit.state import Active, Fitted, Values
from hydrabeam_mpi.inference.likelihood import Likelihood
from hydrabeam_mpi.loop.attribution.evidence import Evidence
from hydrabeam_mpi.loop.attribution.score_effects import CachedRowBlocks, Finding, candidate_sums, weigh
from hydrabeam_mpi.mpi import bcast_object, gather_objects, together


def reconsider(context: FitContext, fitted: Fitted, number: int = -1, beside: Finding | None = None) -> Evidence:
    """Weigh one of the active effects again, by default the last, linearised where it has been fitted.

    Collective: all ranks of the grid. What the linear model expects of it is replaced by what the fit has gained, which
    is `log_joint` beyond that of a fit without it; see `Evidence.linear_gain`. What is weighed ``beside`` it, and is
    not part of the model, is marginalised as well, with the prior that was found for it.
    """
    return _reweigh(context, fitted, number, beside, None)[0]


def compare_priors(
    context: FitContext, fitted: Fitted, number: int, prior_var: FloatArray
) -> tuple[Evidence, Evidence]:
    """Do as `reconsider`, with the best prior and with one of variances ``prior_var``, (n_params,)."""
    best, given = _reweigh(context, fitted, number, None, None, prior_var)
    return best, given


def _reweigh(
    context: FitContext, fitted: Fitted, number: int, beside: Finding | None, *priors: FloatArray | None
) -> list[Evidence]:
    """Weigh an active effect with each of the priors, in one pass over the rows; None is the best one."""
    others = list(fitted.values.active)
    last = others.pop(number)
    if beside is not None:
        evidence = beside.evidence
        others.append(Active.start(beside.effect, context.setup, evidence.prior_var, np.zeros_like(evidence.x)))
    rest = replace(fitted.values, active=tuple(others))
    by_channel = _likelihoods_of(context, fitted, rest, last)
    weighed: list[Evidence] = []
    with together(context.grid.world):
        if by_channel is not None:
            weighed = [weigh(context, rest, last.effect, by_channel, prior_var) for prior_var in priors]
    result: list[Evidence] = bcast_object(context.grid.world, weighed)
    return result


def _likelihoods_of(context: FitContext, fitted: Fitted, rest: Values, last: Active) -> list[Likelihood] | None:
    """Return what each channel says of an active effect, after the ``rest`` of them, around zero; None off rank 0.

    Collective: all ranks of the grid. Places and the like stay where they have been fitted: without its flux a source
    is gone wherever it is.
    """
    nonlinear = last.effect.parameters(context.setup).nonlinear
    with together(context.grid.world):
        cached = CachedRowBlocks.of(context, fitted.estimate)
    found = []
    for channel, number in enumerate(context.channels):
        candidate = {"candidate": CandidateBlock(last.effect, last.x[number])}
        sums = candidate_sums(context, rest, cached, channel, candidate)
        if context.grid.is_group_root:
            one = Marginal(sums, BEAM, fitted.fit.posteriors[channel]).likelihood([*rest.blocks, *candidate])
            n = len(rest.shared)
            score = one.score + one.information[:, n:] @ np.where(nonlinear, 0.0, last.x[number])
            found.append((number, replace(one, score=score)))
    gathered = gather_objects(context.grid.world, found)
    if gathered is None:
        return None
    by_channel = dict(pair for part in gathered for pair in part)
    return [by_channel[number] for number in sorted(by_channel)]
