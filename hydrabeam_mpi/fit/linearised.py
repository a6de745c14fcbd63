"""What rows say of effects near an estimate: sums of the columns of beams and effects, and the beams marginalised."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from hydrabeam_mpi.data.observation import Array, ComplexArray
from hydrabeam_mpi.fit.beams_given import Solved
from hydrabeam_mpi.fit.blocks import EffectBlock, add_block, sums_of
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.equations import BEAM, NormalEquations
from hydrabeam_mpi.fit.marginal import Marginal
from hydrabeam_mpi.fit.rank_data import RankData
from hydrabeam_mpi.fit.rows import Rows
from hydrabeam_mpi.fit.state import Estimate, Values
from hydrabeam_mpi.inference.likelihood import Likelihood
from hydrabeam_mpi.mpi import gather_objects, together


def linearised(
    context: FitContext, at: Estimate, solved: Solved, values: Values
) -> tuple[list[Likelihood] | None, list[Array]]:
    """Return what each channel says of effects near ``at``, the beams marginalised, and how the beams follow them.

    Those of ``values`` are meant, which may be some of the model's. The likelihoods are of all the job's channels, on
    rank 0 alone; the responses, (n_modes, q), of the rank group's. Collective: all ranks of the grid.
    """
    mine, response = [], []
    names = list(values.blocks)
    each = sums_at(context, at, solved.rows, solved.added, values)
    for channel, (sums, posterior) in enumerate(zip(each, at.beams, strict=True)):
        marginal = Marginal(sums, BEAM, posterior)
        response.append(marginal.response(names))
        if context.grid.is_group_root:
            mine.append((context.channels[channel], marginal.likelihood(names)))
    gathered = gather_objects(context.grid.world, mine)
    if gathered is None:
        return None, response
    by_channel = dict(pair for part in gathered for pair in part)
    return [by_channel[f] for f in sorted(by_channel)], response


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
    model = {BEAM: context.beam, **effects}
    total = sums_of(model)
    with together(context.grid.group):
        for _, block, _ in share.row_blocks(channel, at, added, rows):
            add_block(total, block, model)
    total.reduce(context.grid.group)
    if context.learned and share is context.train:
        context.learned.add_to(total, effects, context.channels[channel], at)
    return total
