"""The fitted rows with the current model of them, kept for all that is weighed by them, and sums over them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from hydrabeam_mpi.data.observation import ComplexArray
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.fit.blocks import ColumnBlock, add_block, sums_of
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.equations import BEAM, NormalEquations
from hydrabeam_mpi.fit.kept import Kept
from hydrabeam_mpi.fit.marginal import Marginal
from hydrabeam_mpi.fit.rows import Rows
from hydrabeam_mpi.fit.state import Estimate, Fitted, Values
from hydrabeam_mpi.fit.with_the_beam import with_added, without_beam
from hydrabeam_mpi.loop.attribution.beside import Beside
from hydrabeam_mpi.mpi import gather_items, together


def likelihoods(
    context: FitContext, fitted: Fitted, cached: CachedRowBlocks, candidates: Mapping[str, ColumnBlock]
) -> dict[str, list[Beside]] | None:
    """Return what each channel says of the model's effects and each candidate after them, the beam marginalised.

    On rank 0 alone. Collective: all ranks of the grid.
    """
    group, mine, names = context.grid.group, {}, list(fitted.values.blocks)
    for channel, number in enumerate(context.channels):
        sums = candidate_sums(context, fitted.values, cached, channel, candidates)
        marginal = marginal_of(context, fitted, sums, channel, candidates)
        model = marginal.likelihood(names)
        for one in list(candidates)[group.rank :: group.size]:
            mine[one, number] = Beside.of(model, marginal.likelihood([*names, one]))
    found = gather_items(context.grid.world, mine)
    if found is None:
        return None
    channels = sorted({number for _, number in found})
    return {name: [found[name, number] for number in channels] for name in candidates}


def marginal_of(
    context: FitContext, fitted: Fitted, sums: NormalEquations, channel: int, further: Mapping[str, ColumnBlock]
) -> Marginal:
    """Return a channel's sums, of the model and what is weighed ``further``, with its beam marginalised; serial.

    Where a fit has not converged its beam is not the likeliest given the effects. What it would take up of the residual
    by moving there is no evidence for anything else.
    """
    beam, pull, prior = fitted.fit.posteriors[channel], None, context.given(fitted.values).priors[channel]
    if not fitted.diagnostics.converged and context.problem.coupling is None:
        kappa = 1.0 if beam.is_complex else 2.0
        pull = kappa * sums.projection[BEAM] + prior.precision_times(prior.mean - beam.mean)
    effects = {**fitted.values.blocks, **further}
    return without_beam(context, sums, context.channels[channel], beam, prior, effects, pull)


def candidate_sums(
    context: FitContext,
    values: Values,
    cached: CachedRowBlocks,
    channel: int,
    candidates: Mapping[str, ColumnBlock],
    by_pairs: bool = False,
) -> NormalEquations:
    """Sum one channel's columns of the model's effects and of candidates over the group.

    Their products are those of each candidate by itself, or with ``by_pairs`` those of any two as well.
    """
    model = with_added(context, context.train, cached.at, channel, cached.added[channel], values.blocks)
    if by_pairs:
        model, candidates = {**model, **candidates}, {}
    total = sums_of(model, candidates)
    with together(context.grid.group):
        for block in cached.row_blocks(channel):
            add_block(total, block, model, candidates)
    total.reduce(context.grid.group)
    if context.learned:
        context.learned.add_to(total, values.blocks, context.channels[channel], cached.at)
    return total


@dataclass
class CachedRowBlocks:
    """A rank's fitted rows with the current model of them, as blocks.

    Where memory allows, the blocks are kept, so that what effects computed from them is reused.
    """

    context: FitContext
    at: Estimate
    rows: Rows
    added: ComplexArray
    kept: tuple[Kept[RowBlock], ...]

    @classmethod
    def of(cls, context: FitContext, at: Estimate) -> CachedRowBlocks:
        """Calibrate the rank's rows by the model's effects."""
        kept = tuple(Kept[RowBlock](context.train.room.designs) for _ in context.channels)
        return cls(context, at, *context.train.calibrated(at), kept)

    def row_blocks(self, channel: int) -> Iterator[RowBlock]:
        """Yield the blocks of one channel."""

        def made() -> Iterator[RowBlock]:
            blocks = self.context.train.row_blocks(channel, self.at, self.added[channel], self.rows)
            return (block for _, block, _ in blocks)

        return self.kept[channel].of(None, made)
