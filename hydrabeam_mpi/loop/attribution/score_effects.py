"""Which effect the residual comes from: the evidence for each, with beam and all other parameters marginalised."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.effect import Effect, ScannedEffect
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.fit.blocks import CandidateBlock, ColumnBlock, add_block, sums_of
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.equations import BEAM, NormalEquations
from hydrabeam_mpi.fit.kept import Kept
from hydrabeam_mpi.fit.marginal import Marginal
from hydrabeam_mpi.fit.rows import Rows
from hydrabeam_mpi.fit.state import Estimate, Fitted, Values
from hydrabeam_mpi.inference.likelihood import Likelihood
from hydrabeam_mpi.loop.attribution.evidence import Evidence, evidence_of, find_evidence
from hydrabeam_mpi.loop.attribution.others import Others
from hydrabeam_mpi.mpi import allreduce_sum, bcast_object, gather_objects, together

MAX_ELEMENTS = 350
"""How many of a scan's best candidates are compared together."""


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
    picked = _pick(context, cached, effects)
    picked = [effect for effect in picked if _has_more(context, values, effect)]
    candidates = {
        f"candidate {number}": CandidateBlock(effect, np.zeros(len(effect.parameters(context.setup))))
        for number, effect in enumerate(picked)
    }
    group, likelihoods = context.grid.group, {}
    for channel, number in enumerate(context.channels):
        sums = candidate_sums(context, values, cached, channel, candidates)
        marginal = Marginal(sums, BEAM, fitted.fit.posteriors[channel])
        for one in list(candidates)[group.rank :: group.size]:
            likelihoods[one, number] = marginal.likelihood([*values.blocks, one])
    gathered = gather_objects(context.grid.world, likelihoods)
    findings = None
    with together(context.grid.world):
        if gathered is not None:
            found = {key: one for part in gathered for key, one in part.items()}
            channels = sorted({number for _, number in found})
            findings = [
                Finding(effect, weigh(context, values, effect, [found[name, number] for number in channels]))
                for name, effect in zip(candidates, picked, strict=True)
            ]
            findings.sort(key=lambda finding: -finding.evidence.log_bayes_factor)
    result: list[Finding] = bcast_object(context.grid.world, findings)
    return result


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
    by_channel: list[Likelihood],
    prior_var: FloatArray | None = None,
) -> Evidence:
    """Weigh one effect over all channels, with the active effects marginalised and without what is part of them.

    With ``prior_var``, (n_params,), by that prior; else by the one that has the most evidence.
    """
    parameters = effect.parameters(context.setup)
    scale = parameters.scale.copy()
    scale[taken(values, effect)] = 0.0
    others = Others.of(values, len(by_channel))
    blocks = others.marginalised(by_channel, effect.shared) if values.active else by_channel
    if effect.shared:
        blocks = [sum(blocks[1:], start=blocks[0])] if len(blocks) > 1 else blocks
    parameters, degenerate = replace(parameters, scale=scale), effect.degenerate_directions(context.setup)
    if prior_var is None:
        evidence = find_evidence(blocks, parameters, degenerate)
    else:
        evidence = evidence_of(blocks, parameters, prior_var, degenerate)
    return replace(evidence, absorbed=_absorbed(evidence, by_channel)) if values.active else evidence


def _absorbed(evidence: Evidence, by_channel: list[Likelihood]) -> float:
    """Return how much of an effect's signature the beam takes up, whatever the active effects take besides."""
    own = slice(-evidence.x.shape[1], None)
    seen = present = 0.0
    for one, x in zip(by_channel, np.broadcast_to(evidence.x, (len(by_channel), evidence.x.shape[1])), strict=True):
        seen += float(x @ one.information[own, own] @ x)
        present += float(x @ one.signal[own, own] @ x)
    return float(np.clip(1 - seen / present, 0.0, 1.0)) if present > 0 else 0.0


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
    model: dict[str, ColumnBlock] = {BEAM: context.beam, **values.blocks}
    if by_pairs:
        model, candidates = {**model, **candidates}, {}
    total = sums_of(model, candidates)
    with together(context.grid.world):
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
    kept: Kept[RowBlock]

    @classmethod
    def of(cls, context: FitContext, at: Estimate) -> CachedRowBlocks:
        """Calibrate the rank's rows by the model's effects."""
        return cls(context, at, *context.train.calibrated(at), Kept(context.train.keeps_designs))

    def row_blocks(self, channel: int) -> Iterator[RowBlock]:
        """Yield the blocks of one channel."""

        def made() -> Iterator[RowBlock]:
            blocks = self.context.train.row_blocks(channel, self.at, self.added[channel], self.rows)
            return (block for _, block, _ in blocks)

        return self.kept.of(channel, made)


def _pick(context: FitContext, cached: CachedRowBlocks, effects: Sequence[Effect]) -> list[Effect]:
    """Scan where there are too many candidates, and keep the best of them."""
    scanned = [effect for effect in effects if isinstance(effect, ScannedEffect)]
    best = {
        id(effect): effect.at(context.setup, np.argsort(-score, kind="stable")[:MAX_ELEMENTS])
        for effect, score in zip(scanned, _scan(context, cached, scanned), strict=True)
    }
    return [best.get(id(effect), effect) for effect in effects]


def _scan(context: FitContext, cached: CachedRowBlocks, effects: Sequence[ScannedEffect]) -> list[FloatArray]:
    """Return by how much each candidate alone would lower chi^2 with the beam as it is, (n_hypotheses,) an effect."""
    sums: list[list[Any]] = [[0.0] * len(context.channels) for _ in effects]
    with together(context.grid.world):
        for channel in range(len(context.channels)):
            for block in cached.row_blocks(channel):
                for effect, by_channel in zip(effects, sums, strict=True):
                    by_channel[channel] = by_channel[channel] + np.stack(effect.scan(block))
    return [_drops(context, effect, np.array(by_channel)) for effect, by_channel in zip(effects, sums, strict=True)]


def _drops(context: FitContext, effect: ScannedEffect, found: FloatArray) -> FloatArray:
    """Add the sums of a scan over ranks and channels. Collective: all ranks of the grid."""
    shape = max(context.grid.world.allgather(found.shape[1:]))  # ranks without rows do not know it
    found = found if found.shape[1:] == shape else np.zeros((len(found), *shape))
    allreduce_sum(context.grid.group, found)
    if effect.shared:
        total = found.sum(axis=0) if context.grid.is_group_root else np.zeros(shape)
        allreduce_sum(context.grid.world, total)
        return _chi2_drop(total)
    drop = np.sum([_chi2_drop(one) for one in found], axis=0)
    if not context.grid.is_group_root:
        drop[:] = 0.0
    allreduce_sum(context.grid.world, drop)
    return np.asarray(drop)


def _chi2_drop(sums: FloatArray) -> FloatArray:
    """Return 2 (Re sum w s* r)^2 / sum w |s|^2, summed over a candidate's columns."""
    score, power = sums
    told = power > 0
    return np.asarray(np.sum(np.where(told, 2 * score**2 / np.where(told, power, 1.0), 0.0), axis=-1))
