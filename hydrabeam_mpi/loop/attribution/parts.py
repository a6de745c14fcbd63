"""Parts of the fitted data, and what each of them says of the parameters of an effect."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array, hstack

from hydrabeam_mpi.data.observation import FloatArray, IntArray
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.fit.blocks import EffectBlock
from hydrabeam_mpi.fit.columns import Columns, RowSet
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.equations import BEAM
from hydrabeam_mpi.fit.gauss_newton import active_sums
from hydrabeam_mpi.fit.marginal import Marginal
from hydrabeam_mpi.fit.state import Active, Fitted
from hydrabeam_mpi.inference.likelihood import Likelihood
from hydrabeam_mpi.loop.attribution.constancy import Constancy, compare
from hydrabeam_mpi.loop.attribution.evidence import price_of
from hydrabeam_mpi.loop.attribution.score_effects import without_active
from hydrabeam_mpi.mpi import bcast_object, gather_objects, together
from hydrabeam_mpi.random import generator

MOST_PARTS = 4
"""Blocks of times, and folds of redundant groups: so few that each tells the parameters by itself, and that slow
changes do not look like several that agree; their spread is seen to two fifths."""
MOST_COLUMNS = 1000
"""Parameters times parts at most: such matrices are decomposed in a second. Effects with many parameters are compared
in fewer parts; with too many for two parts they are not asked."""


@dataclass(frozen=True)
class PartedBlock:
    """The parameters of an effect in use, anew in each part of the data, for each kind of parts; a `ColumnBlock`.

    Attributes
    ----------
    active : Active
    used : ndarray of int, (q,)
    parts : dict of str to ndarray of int, (Ntimes, Ngroups)
        By kind of parts, to which the rows of a time and a redundant group belong.
    n_parts : dict of str to int
        By kind, how many there are.
    """

    active: Active
    used: IntArray
    parts: Mapping[str, IntArray]
    n_parts: Mapping[str, int]
    is_complex: bool = False

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return len(self.used) * sum(self.n_parts.values())

    @property
    def effects(self) -> Sequence[Effect]:
        """The effect."""
        return (self.active.effect,)

    @property
    def x(self) -> FloatArray:
        """Where the unknowns have been fitted, (Nfreqs, size): every kind of parts has the whole effect, here one."""
        first, *others = self.n_parts.values()
        x = self.active.x[:, self.used]
        return np.hstack([np.tile(x, first), np.zeros((len(x), len(self.used) * sum(others)))])

    @property
    def spans(self) -> dict[str, slice]:
        """Where the unknowns of each kind of parts are."""
        ends = np.cumsum([0, *(len(self.used) * n for n in self.n_parts.values())]).tolist()
        return dict(zip(self.n_parts, map(slice, ends[:-1], ends[1:]), strict=True))

    def columns(self, rows: RowSet, block: RowBlock) -> Columns:
        """Return the effect's columns, each in the part of its row."""
        made = self.active.effect.columns(block, self.active.x[block.channel])
        matrix = csr_array(made.matrix()[:, self.used])
        groups = block.groups if made.by_group else block.groups[block.member]
        of_kinds = []
        for kind, n_parts in self.n_parts.items():
            part = self.parts[kind][block.times[:, np.newaxis], groups].reshape(-1)
            columns = matrix.indices + len(self.used) * np.repeat(part, np.diff(matrix.indptr))
            shape = len(part), n_parts * len(self.used)
            of_kinds.append(csr_array((matrix.data, columns, matrix.indptr), shape=shape))
        return Columns(rows, hstack(of_kinds, format="csr"), made.by_group)


def ask_constancy(context: FitContext, fitted: Fitted, place: int) -> tuple[Constancy, ...]:
    """Tell whether the active effect at a ``place`` is the same in all parts, for each kind of parts.

    Collective: all ranks of the grid. Takes one pass over the rows. Places and the like stay where they are. Empty for
    effects that cannot be asked, as there are less than two parts.
    """
    others = list(fitted.values.active)
    one = others.pop(place)
    prior_var: FloatArray = np.zeros(one.x.shape[1])
    prior_var[one.used] = one.prior.of(0).std() ** 2
    prior_var[one.effect.parameters(context.setup).nonlinear] = 0.0
    parted = parted_block(context, one, np.flatnonzero(prior_var))
    if not parted.n_parts:
        return ()
    rest = replace(fitted.values, active=tuple(others))
    by_channel = likelihoods_of(context, fitted, {**rest.blocks, "parts": parted}, parted.x)
    found: tuple[Constancy, ...] = ()
    with together(context.grid.world):
        if by_channel is not None:
            blocks = without_active(rest, one.effect, by_channel) if others else by_channel
            blocks = [sum(blocks[1:], start=blocks[0])] if one.effect.shared else blocks
            found = tuple(_compare(context, parted, kind, prior_var, blocks) for kind in parted.n_parts)
    result: tuple[Constancy, ...] = bcast_object(context.grid.world, found)
    return result


def likelihoods_of(
    context: FitContext, fitted: Fitted, blocks: Mapping[str, EffectBlock], x: FloatArray
) -> list[Likelihood] | None:
    """Return what each channel says of blocks with the beam marginalised, of the last one around zero; None off rank 0.

    Collective: all ranks of the grid. ``x``, (Nfreqs, size), is where the last block's unknowns have been fitted.
    """
    with together(context.grid.world):
        rows, added = context.train.calibrated(fitted.estimate)
    found = []
    for channel, number in enumerate(context.channels):
        sums = active_sums(context, context.train, fitted.estimate, channel, rows, added[channel], blocks)
        if context.grid.is_group_root:
            one = Marginal(sums, BEAM, fitted.fit.posteriors[channel]).likelihood(list(blocks))
            score = one.score + one.information[:, -x.shape[1] :] @ x[number]
            found.append((number, replace(one, score=score)))
    gathered = gather_objects(context.grid.world, found)
    if gathered is None:
        return None
    by_channel = dict(pair for part in gathered for pair in part)
    return [by_channel[number] for number in sorted(by_channel)]


def _compare(
    context: FitContext, parted: PartedBlock, kind: str, prior_var: FloatArray, blocks: list[Likelihood]
) -> Constancy:
    """Compare the parameters in parts of one kind."""
    active, used, span = parted.active, parted.used, parted.spans[kind]
    own = [Likelihood(one.information[span, span], one.score[span], one.signal[span, span]) for one in blocks]
    held = np.tile(active.degenerate_directions[:, used], parted.n_parts[kind])
    if len(held):
        own = [one.freed(held) for one in own]
    price = price_of(active.effect.parameters(context.setup), prior_var)
    return compare(own, np.sqrt(prior_var[used]), kind, price)


def parted_block(context: FitContext, active: Active, used: IntArray) -> PartedBlock:
    """Cut the fitted rows into blocks of times, and besides into folds of groups, of which there are two at least.

    Times of a block follow each other; groups are dealt out at random, so that no fold has a direction of its own.
    ``used``, (q,), are the numbers of the effect's parameters that are asked.
    """
    times, redundant = np.sort(context.problem.train.times), context.problem.redundant
    groups = np.unique(redundant.group[context.problem.train.bls])
    most = min(MOST_PARTS, MOST_COLUMNS // max(len(used), 1)) if len(used) else 0
    of_kinds = {"times": min(most, len(times)), "baselines": min(most, len(groups))}
    n_parts = {kind: n for kind, n in of_kinds.items() if n > 1}
    block, fold = (
        np.zeros((context.setup.observation.Ntimes, 1), dtype=int),
        np.zeros((1, redundant.Ngroups), dtype=int),
    )
    block[times, 0] = np.arange(len(times)) * of_kinds["times"] // len(times)
    fold[0, groups] = generator(0, "folds of groups").permutation(len(groups)) % max(of_kinds["baselines"], 1)
    shape = len(block), fold.shape[1]
    parts = {"times": np.broadcast_to(block, shape), "baselines": np.broadcast_to(fold, shape)}
    return PartedBlock(active, used, parts, n_parts)
