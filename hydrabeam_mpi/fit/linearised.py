"""What rows say of effects near an estimate: sums of the columns of beams and effects, and the beams marginalised."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from hydrabeam_mpi.data.observation import Array, ComplexArray, FloatArray
from hydrabeam_mpi.fit.beams_given import Solved
from hydrabeam_mpi.fit.blocks import EffectBlock, add_block, sums_of
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.equations import BEAM, NormalEquations
from hydrabeam_mpi.fit.rank_data import RankData
from hydrabeam_mpi.fit.rows import Rows
from hydrabeam_mpi.fit.state import Estimate, Values
from hydrabeam_mpi.fit.with_the_beam import with_added, without_beam
from hydrabeam_mpi.inference.likelihood import Likelihood
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.inference.prior import Prior
from hydrabeam_mpi.mpi import gather_items, together


def linearised(
    context: FitContext, at: Estimate, solved: Solved, values: Values
) -> tuple[list[Likelihood] | None, list[Array]]:
    """Return what each channel says of effects near ``at``, the beams marginalised, and how the beams follow them.

    Those of ``values`` are meant, which may be some of the model's. The likelihoods are of all the job's channels, on
    rank 0 alone; the responses, (n_modes, q), of the rank group's. Collective: all ranks of the grid.
    """
    mine, response = {}, []
    names = list(values.blocks)
    each, priors = sums_at(context, at, solved.rows, solved.added, values), context.given(at.values).priors
    for channel, (sums, posterior) in enumerate(zip(each, at.beams, strict=True)):
        number, prior = context.channels[channel], priors[channel]
        marginal = without_beam(context, sums, number, posterior, prior, values.blocks)
        response.append(marginal.response(names))
        if context.grid.is_group_root:
            told = marginal.likelihood(names)
            score = told.score + _rounding(context, values, sums, posterior, prior)
            mine[number] = replace(told, score=score)
    by_channel = gather_items(context.grid.world, mine)
    return None if by_channel is None else list(by_channel.values()), response


def _rounding(
    context: FitContext, values: Values, sums: NormalEquations, posterior: Posterior, prior: Prior
) -> FloatArray:
    """Return by how much rounding makes the score of effects differ that have the beam's own columns, (q,).

    At the beam's best values the data pull on it as its prior does, the other way. With p = A^H N^-1 (d - A b) the sums
    have the same, but for what rounding makes of residuals that are a small part of d: next to nothing beside what
    the data tell of the beam, and a millionth of a standard deviation where its prior tells as much.
    """
    rest = prior.precision_times(posterior.mean - prior.mean)
    rest = rest - sums.projection[BEAM] * (1 if posterior.is_complex else 2)
    parts = 2 * np.concatenate([rest.real, rest.imag]) if posterior.is_complex else rest
    out = np.zeros(len(values.shared))
    for one, span in zip(values.active, values.spans, strict=True):
        if one.effect.beam_coefficients(context.setup, one.x) is not None:
            out[span] = parts[one.used]
    return out


def sums_at(
    context: FitContext, at: Estimate, rows: Rows, added: ComplexArray, values: Values
) -> Iterator[NormalEquations]:
    """Yield those of beams and of some effects of each of the group's channels. Collective: all ranks of the grid."""
    for channel in range(len(at.beams)):
        yield active_sums(context, context.train, at, channel, rows, added[channel], values.blocks)


def active_sums(
    context: FitContext,
    share: RankData,
    at: Estimate,
    channel: int,
    rows: Rows,
    added: ComplexArray,
    effects: Mapping[str, EffectBlock],
) -> NormalEquations:
    """Sum over a group's rows the columns of the beam and of ``effects``, such as those that are active.

    ``added`` is E of the channel's rows, (Ntimes, Nbls). What a result says that is the prior counts as fitted rows.
    Collective: all ranks of `grid.group`; groups may have different numbers of channels.
    """
    model = with_added(context, share, at, channel, added, effects)
    total = sums_of(model)
    with together(context.grid.group):
        for _, block, _ in share.row_blocks(channel, at, added, rows):
            add_block(total, block, model)
    total.reduce(context.grid.group)
    if context.learned and share is context.train:
        context.learned.add_to(total, effects, context.channels[channel], at)
    return total
