"""Who owns which rows: rectangles of times x baseline groups, balanced by cost. Pure integers, no MPI."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray, IntArray

BASIS_COST = 50.0
"""What it takes to evaluate the basis at a time's sources, in rows of a baseline group at that time. Measured: 49 in
the paper's case; both grow with modes and sources."""


@dataclass(frozen=True)
class Tile:
    """A rectangle of rows.

    Attributes
    ----------
    times : ndarray of int
        Indices into ``Observation.times``.
    bls : ndarray of int
        Indices into ``Observation.antpairs``; whole redundant groups.
    """

    times: IntArray
    bls: IntArray

    @property
    def size(self) -> int:
        """Number of (time, baseline) rows."""
        return len(self.times) * len(self.bls)


def spans(sizes: Iterable[int]) -> list[slice]:
    """Return where parts of these sizes lie when they are side by side."""
    ends = np.cumsum([0, *sizes]).tolist()
    return list(map(slice, ends[:-1], ends[1:]))


def split_by_cost(costs: FloatArray, n_parts: int) -> list[slice]:
    """Cut a sequence with ``costs``, (N,), into ``n_parts`` contiguous parts of nearly equal cost, some perhaps empty.

    Each cut is put where the running cost is nearest to its share of the total.
    """
    running = np.concatenate([[0.0], np.cumsum(costs)])
    targets = running[-1] * np.arange(n_parts + 1) / n_parts
    middles = 0.5 * (running[1:] + running[:-1])
    cuts = np.searchsorted(middles, targets, side="left")
    cuts[0], cuts[-1] = 0, len(costs)
    return [slice(lo, hi) for lo, hi in pairwise(cuts.tolist())]


def make_tiles(times: IntArray, time_costs: FloatArray, bls: IntArray, group: IntArray, n_ranks: int) -> list[Tile]:
    """Deal out rows to ranks.

    Times are cut into runs and the baseline groups of a run among its ranks, into as many runs as let the slowest rank
    end first: cutting groups balances better, but each rank of a run evaluates the basis at all of its sources.

    Parameters
    ----------
    times : ndarray of int, (Nt,)
        Indices of the times to deal out.
    time_costs : ndarray, (Nt,)
        Relative cost of each, such as its number of sources above the horizon.
    bls : ndarray of int, (Nb,)
        Indices of the baselines to deal out.
    group : ndarray of int, (Nb,)
        Redundant group of each; a group is never torn.
    n_ranks : int
        Number of ranks.

    Returns
    -------
    list of Tile
        One a rank, disjoint, together all rows. Idle ranks have an empty tile.
    """
    groups, costs = np.unique(group), np.asarray(time_costs, dtype=float)
    cuts = [_Cut.of(costs, len(groups), n_runs, n_ranks) for n_runs in range(1, min(n_ranks, len(times)) + 1)]
    if not cuts:
        return [Tile(times[:0], bls[:0])] * n_ranks
    best = min(reversed(cuts), key=lambda cut: cut.slowest)
    tiles = []
    for run, n_parts in zip(best.runs, best.ranks, strict=True):
        for part in split_by_cost(np.ones(len(groups)), n_parts):
            mine = np.isin(group, groups[part])
            tiles.append(Tile(times[run], bls[mine]) if mine.any() else Tile(times[:0], bls[:0]))
    return tiles


@dataclass(frozen=True)
class _Cut:
    """Times cut into runs, with how many ranks each has, and what the slowest rank has to do."""

    runs: list[slice]
    ranks: list[int]
    slowest: float

    @classmethod
    def of(cls, costs: FloatArray, n_groups: int, n_runs: int, n_ranks: int) -> _Cut:
        """Cut times into runs of equal cost; ranks that are left over go where there is most to do."""
        runs = split_by_cost(costs, n_runs)
        loads = np.array([costs[run].sum() for run in runs])
        ranks = np.full(n_runs, n_ranks // n_runs)
        for _ in range(n_ranks % n_runs):
            ranks[np.argmax(loads * (BASIS_COST + np.ceil(n_groups / ranks)))] += 1
        slowest = np.max(loads * (BASIS_COST + np.ceil(n_groups / ranks)))
        return cls(runs, ranks.tolist(), float(slowest))
