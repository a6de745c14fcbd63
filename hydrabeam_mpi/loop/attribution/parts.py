"""Parts of the fitted data, and what each of them says of the parameters of an effect."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array, hstack

from hydrabeam_mpi.data.observation import BoolArray, FloatArray, IntArray, Observation
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.eigen import IN_A_SECOND
from hydrabeam_mpi.fit.blocks import member_of_rows
from hydrabeam_mpi.fit.columns import Columns, RowSet
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.error_scale import ErrorScale, error_scale
from hydrabeam_mpi.fit.state import Active, Fitted
from hydrabeam_mpi.inference.likelihood import Likelihood
from hydrabeam_mpi.loop.attribution.candidate_rows import CachedRowBlocks, candidate_sums, marginal_of
from hydrabeam_mpi.loop.attribution.constancy import Constancy, compare
from hydrabeam_mpi.loop.attribution.others import Others
from hydrabeam_mpi.loop.attribution.price import price_of
from hydrabeam_mpi.loop.residuals.remains import Remains
from hydrabeam_mpi.mpi import bcast_object, gather_items, together
from hydrabeam_mpi.random import generator
from hydrabeam_mpi.words import joined

AXES = ("channels", "times", "baselines")
"""Of the rows, in their order."""
MOST_PARTS = 4
"""Blocks of times or of channels, and folds of redundant groups: so few that each tells the parameters by itself, and
that slow changes do not look like several that agree; their spread is seen to two fifths."""
MOST_COLUMNS = IN_A_SECOND
"""Parameters times parts at most. Effects with many parameters are compared in fewer parts; with too many for two parts
they are not asked."""


@dataclass(frozen=True)
class PartedBlock:
    """The parameters of an effect in use, anew in each part of the data, for each kind of parts; a `ColumnBlock`.

    Attributes
    ----------
    active : Active
    used : ndarray of int, (q,)
    parts : dict of str to ndarray of int, (Nfreqs, Ntimes, Ngroups)
        By kind of parts, to which the rows of a channel, a time and a redundant group belong.
    n_parts : dict of str to int
        By kind, how many there are.
    of_baselines : str, optional
        The kind whose parts are of baselines, (Nfreqs, Ntimes, Nbls), whatever their group.
    """

    active: Active
    used: IntArray
    parts: Mapping[str, IntArray]
    n_parts: Mapping[str, int]
    of_baselines: str | None = None
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
        made = block.columns_of(self.active.effect, self.active.x[block.channel])
        matrix, by_group = csr_array(made.matrix()[:, self.used]), made.by_group
        if by_group and self.of_baselines is not None:
            matrix, by_group = matrix[member_of_rows(block)], False
        groups = block.groups if by_group else block.groups[block.member]
        of_kinds = []
        for kind, n_parts in self.n_parts.items():
            which = block.bls if kind == self.of_baselines else groups
            part = self.parts[kind][block.channel, block.times[:, np.newaxis], which].reshape(-1)
            columns = matrix.indices + len(self.used) * np.repeat(part, np.diff(matrix.indptr))
            shape = len(part), n_parts * len(self.used)
            of_kinds.append(csr_array((matrix.data, columns, matrix.indptr), shape=shape))
        return Columns(rows, hstack(of_kinds, format="csr"), by_group)


@dataclass(frozen=True)
class Affected:
    """The baselines on which most of what is left of the data lives, where these are few.

    Attributes
    ----------
    name : str
        What they and the others are called.
    bls : ndarray of bool, (Nbls,)
    """

    name: str
    bls: BoolArray

    @classmethod
    def of(cls, remains: Remains, observation: Observation) -> Affected | None:
        """Return those of the antennas, or else the baselines, that carry what is left; None where it is anywhere."""
        if remains.consistent:
            return None
        axes = [
            ("antennas", observation.antenna_numbers[observation.antenna_index]),
            ("baselines", observation.antpairs),
        ]
        for axis, numbers in axes:
            told = remains.where.get(axis)
            if told is None or told["state"] != "concentrated":
                continue
            carriers = [one["what"] for one in told["entries"]]
            pairs = numbers.tolist()
            of_antennas = axis == "antennas"
            hit = [bool(set(pair) & set(carriers)) if of_antennas else pair in carriers for pair in pairs]
            named = joined([str(one) if of_antennas else "-".join(map(str, one)) for one in carriers])
            plural = "s" if len(carriers) > 1 else ""
            which = f"baselines of antenna{plural} {named}" if of_antennas else f"baseline{plural} {named}"
            return cls(f"the {which}, on which most of what is left lives, and the others", np.array(hit))
        return None


def ask_constancy(
    context: FitContext, fitted: Fitted, places: Iterable[int], affected: Affected | None = None
) -> dict[int, tuple[Constancy, ...]]:
    """Tell whether the active effects at some ``places`` are the same in all parts, for each kind of parts.

    Where what is left of the data lives on few baselines, those that are ``affected``, these and the others are parts
    as well: what is there on the others is no matter of what is wrong with these few.

    Collective: all ranks of the grid. Takes one pass over the rows. Places and the like stay where they are. Empty for
    effects that cannot be asked, as there are less than two parts.
    """
    active, widths, parted = fitted.values.active, {}, {}
    for place in places:
        widths[place] = active[place].prior_var(context.setup)
        parted[place] = parted_block(context, active[place], np.flatnonzero(widths[place]), affected)
    asked = {place: block for place, block in parted.items() if block.n_parts}
    likelihoods = likelihoods_of(context, fitted, asked) if asked else {}
    errors = error_scale(context, fitted)
    found: dict[int, tuple[Constancy, ...]] = {}
    with together(context.grid.world):
        for place, by_channel in (likelihoods or {}).items():
            effect, rest = active[place].effect, fitted.values.without(place)
            others = Others.of(rest, len(by_channel))
            blocks = others.marginalised(by_channel, effect.shared) if rest.active else by_channel
            blocks = [sum(blocks[1:], start=blocks[0])] if effect.shared else blocks
            block = parted[place]
            found[place] = tuple(
                _compare(context, block, kind, widths[place], blocks, errors) for kind in block.n_parts
            )
    result: dict[int, tuple[Constancy, ...]] = bcast_object(context.grid.world, found)
    return {place: result.get(place, ()) for place in parted}


def likelihoods_of(
    context: FitContext, fitted: Fitted, parted: Mapping[int, PartedBlock]
) -> dict[int, list[Likelihood]] | None:
    """Return what each channel says of the active effects at some places in parts, around zero; None off rank 0.

    Collective: all ranks of the grid. Those of the other active effects come first, the beam is marginalised.
    """
    names, values = list(fitted.values.blocks), fitted.values
    with together(context.grid.world):
        cached = CachedRowBlocks.of(context, fitted.estimate)
    found = {}
    for channel, number in enumerate(context.channels):
        blocks = {f"parts of {place}": block for place, block in parted.items()}
        sums = candidate_sums(context, values, cached, channel, blocks)
        if context.grid.is_group_root:
            marginal = marginal_of(context, fitted, sums, channel, blocks)
            for place, block in parted.items():
                one = marginal.likelihood([*names[:place], *names[place + 1 :], f"parts of {place}"])
                score = one.score + one.information[:, -block.size :] @ block.x[number]
                found[place, number] = replace(one, score=score)
    by_channel = gather_items(context.grid.world, found)
    if by_channel is None:
        return None
    channels = sorted({number for _, number in by_channel})
    return {place: [by_channel[place, number] for number in channels] for place in parted}


def _compare(
    context: FitContext,
    parted: PartedBlock,
    kind: str,
    prior_var: FloatArray,
    blocks: list[Likelihood],
    errors: ErrorScale,
) -> Constancy:
    """Compare the parameters in parts of one kind."""
    active, used, span = parted.active, parted.used, parted.spans[kind]
    own = [Likelihood(one.information[span, span], one.score[span], one.signal[span, span]) for one in blocks]
    held = np.tile(active.degenerate_directions[:, used], parted.n_parts[kind])
    if len(held):
        own = [one.freed(held) for one in own]
    price = price_of(active.effect.parameters(context.setup), prior_var)
    return compare(own, np.sqrt(prior_var[used]), kind, price, (errors.of_blocks(active.effect) ** 2).tolist())


def parted_block(context: FitContext, active: Active, used: IntArray, affected: Affected | None = None) -> PartedBlock:
    """Cut the fitted rows into blocks of times, into folds of groups and into blocks of channels, two or more of each.

    Times and channels of a block follow each other; groups are dealt out at random, so that no fold has a direction of
    its own. What every channel has for itself is not asked between channels. ``used``, (q,), are the numbers of the
    effect's parameters that are asked.
    """
    train, redundant, observation = context.problem.train, context.problem.redundant, context.setup.observation
    shape = observation.Nfreqs, observation.Ntimes, redundant.Ngroups
    members = {"times": np.sort(train.times), "baselines": np.unique(redundant.group[train.bls])}
    members |= {"channels": np.arange(observation.Nfreqs)} if active.effect.shared else {}
    most = min(MOST_PARTS, MOST_COLUMNS // max(len(used), 1)) if len(used) else 0
    n_parts = {kind: min(most, len(one)) for kind, one in members.items() if min(most, len(one)) > 1}
    parts = {kind: _divided(kind, members[kind], n, shape) for kind, n in n_parts.items()}
    if affected is None or most < 2 or affected.bls[train.bls].all() or not affected.bls[train.bls].any():
        return PartedBlock(active, used, parts, n_parts)
    parts[affected.name] = np.broadcast_to(affected.bls.astype(int), (*shape[:2], len(affected.bls)))
    return PartedBlock(active, used, parts, n_parts | {affected.name: 2}, affected.name)


def _divided(kind: str, members: IntArray, n_parts: int, shape: tuple[int, ...]) -> IntArray:
    """Divide the members of an axis into parts; return that of each row as a view, (Nfreqs, Ntimes, Ngroups)."""
    axis, number = AXES.index(kind), np.arange(len(members))
    part, along = np.zeros(shape[axis], dtype=int), [1, 1, 1]
    if kind == "baselines":
        part[members] = generator(0, "folds of groups").permutation(len(members)) % n_parts
    else:
        part[members] = number * n_parts // len(members)
    along[axis] = -1
    return np.broadcast_to(part.reshape(along), shape)
