"""Which of many candidates are weighed: sources, baselines, directions, by how much each alone would explain."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray, IntArray
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.interface.scanned import ScannedEffect
from hydrabeam_mpi.effects.shared.in_time import InTime
from hydrabeam_mpi.fit.blocks import CandidateBlock
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.state import Fitted
from hydrabeam_mpi.inference.likelihood import RANK_RTOL
from hydrabeam_mpi.loop.attribution.beside import KnownModel
from hydrabeam_mpi.loop.attribution.candidate_rows import CachedRowBlocks, likelihoods
from hydrabeam_mpi.mpi import allreduce_sum, bcast_object, together


def pick(context: FitContext, fitted: Fitted, cached: CachedRowBlocks, effects: Sequence[Effect]) -> list[Effect]:
    """Scan where there are too many candidates, and keep the best of them. Collective: all ranks of the grid.

    The beam follows most what is brightest, of which it may leave little to see. So the brightest are looked at again
    beside those that are the best with the beam as it is, now with the beam and the model's effects marginalised.
    """
    # By their number, which is the same on all ranks.
    scanned = {number: effect for number, effect in enumerate(effects) if isinstance(effect, ScannedEffect)}
    best: dict[int, IntArray] = {}
    again: dict[int, Effect] = {}
    found = _scan(context, cached, list(scanned.values()))
    for (number, effect), (drop, power) in zip(scanned.items(), found, strict=True):
        order = np.argsort(-drop, kind="stable")
        by_turns = _by_turns(order, brightest_first(drop, power, effect.of_the_same(context.setup)))
        first = effect.expanded(context.setup, by_turns[: effect.most_again])
        every = effect.every(context.setup, first)
        best[number] = order[: effect.most_again] if every is None else first
        if every is not None:
            again[number] = every
    for number, drop in _drops_beside(context, fitted, cached, again).items():
        best[number] = best[number][np.argsort(-drop, kind="stable")]
    chosen = {number: effect.at(context.setup, best[number]) for number, effect in scanned.items()}
    return [chosen.get(number, effect) for number, effect in enumerate(effects)]


def brightest_first(drop: FloatArray, power: FloatArray, same: IntArray) -> IntArray:
    """Return the candidates by power, of those that are the ``same`` thing the best alone; arguments are (n,)."""
    order = np.lexsort((-drop, -power))
    return order[np.sort(np.unique(same[order], return_index=True)[1])]


def _by_turns(one: IntArray, two: IntArray) -> IntArray:
    """Return what is in one list and in the other, by turns, each once."""
    n = min(len(one), len(two))
    both = np.concatenate([np.stack([one[:n], two[:n]], axis=1).ravel(), one[n:], two[n:]])
    return both[np.sort(np.unique(both, return_index=True)[1])]


def _drops_beside(
    context: FitContext, fitted: Fitted, cached: CachedRowBlocks, effects: Mapping[int, Effect]
) -> dict[int, FloatArray]:
    """Return by how much each element would lower chi^2 with all but itself marginalised, (n_elements,) an effect.

    Its parameters are taken as orthogonal. Collective: all ranks of the grid.
    """
    if not effects:
        return {}
    candidates = {
        str(key): CandidateBlock(effect, np.zeros(len(effect.parameters(context.setup))))
        for key, effect in effects.items()
    }
    by_name, found = likelihoods(context, fitted, cached, candidates), None
    with together(context.grid.world):
        if by_name is not None:
            found = []
            model = KnownModel.of(fitted.values, next(iter(by_name.values())))
            for key, effect in effects.items():
                element = effect.parameters(context.setup).element
                drop = np.zeros(int(element.max(initial=-1)) + 1)
                for one in model.left(by_name[str(key)], effect.shared):
                    seen, present = np.diag(one.information), np.diag(one.signal)
                    told = seen > RANK_RTOL * present
                    drop += np.bincount(element, np.where(told, one.score**2 / np.where(told, seen, 1.0), 0.0))
                found.append(drop)
    told_all: list[FloatArray] = bcast_object(context.grid.world, found)
    return dict(zip(effects, told_all, strict=True))


def _scan(context: FitContext, cached: CachedRowBlocks, effects: Sequence[ScannedEffect]) -> list[FloatArray]:
    """Return by how much each candidate alone would lower chi^2 with the beam as it is, and its own power.

    Both are (n_hypotheses,); the result has (2, n_hypotheses) an effect.
    """
    sums: list[list[Any]] = [[0.0] * len(context.channels) for _ in effects]
    with together(context.grid.world):
        for channel in range(len(context.channels)):
            for block in cached.row_blocks(channel):
                for by_channel, found in zip(sums, _scan_block(block, effects), strict=True):
                    by_channel[channel] = by_channel[channel] + found
    return [_drops(context, effect, np.array(by_channel)) for effect, by_channel in zip(effects, sums, strict=True)]


def _scan_block(block: RowBlock, effects: Sequence[ScannedEffect]) -> list[FloatArray]:
    """Return the sums of each effect over a block, (2, n_hypotheses, p).

    Effects with the same candidates, which go on in time in one way or another, are scanned in one pass.
    """
    groups: dict[object, list[int]] = {}
    for number, effect in enumerate(effects):
        own = _scanned(effect)
        groups.setdefault((own.kind, own.law, json.dumps(own.describe())), []).append(number)
    found: dict[int, FloatArray] = {}
    for first, *others in groups.values():
        if not others:
            found[first] = np.stack(effects[first].scan(block))
            continue
        functions = [_functions(effects[number], block) for number in (first, *others)]
        edges = np.cumsum([one.shape[1] for one in functions])
        sums = np.stack(_scanned(effects[first]).scan_in_time(block, np.concatenate(functions, axis=1)))
        n_each = sums.shape[-1] // edges[-1]
        found.update(zip((first, *others), np.split(sums, n_each * edges[:-1], axis=-1), strict=True))
    return [found[number] for number in range(len(effects))]


def _scanned(effect: ScannedEffect) -> ScannedEffect:
    """Return the effect that the candidates are of."""
    if isinstance(effect, InTime) and isinstance(effect.effect, ScannedEffect):
        return effect.effect
    return effect.scanned_as


def _functions(effect: ScannedEffect, block: RowBlock) -> FloatArray:
    """Return the functions of time that the candidates are scanned with, (Ntimes, k)."""
    return effect.scanned_functions(block) if isinstance(effect, InTime) else np.ones((len(block.times), 1))


def _drops(context: FitContext, effect: ScannedEffect, found: FloatArray) -> FloatArray:
    """Add the sums of a scan over ranks and channels. Collective: all ranks of the grid."""
    shape = max(context.grid.world.allgather(found.shape[1:]))  # ranks without rows do not know it
    found = found if found.shape[1:] == shape else np.zeros((len(found), *shape))
    allreduce_sum(context.grid.group, found)
    if effect.shared:
        total = found.sum(axis=0) if context.grid.is_group_root else np.zeros(shape)
        allreduce_sum(context.grid.world, total)
        return _drop_and_power(total)
    drops = np.sum([_drop_and_power(one) for one in found], axis=0)
    if not context.grid.is_group_root:
        drops[:] = 0.0
    allreduce_sum(context.grid.world, drops)
    return np.asarray(drops)


def _drop_and_power(sums: FloatArray) -> FloatArray:
    """Return 2 (Re sum w s* r)^2 / sum w |s|^2 and sum w |s|^2, each summed over a candidate's columns."""
    score, power = sums
    told = power > 0
    drop = np.where(told, 2 * score**2 / np.where(told, power, 1.0), 0.0)
    return np.stack([drop.sum(axis=-1), power.sum(axis=-1)])
