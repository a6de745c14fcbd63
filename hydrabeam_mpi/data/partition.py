"""Who owns which rows: rectangles of times x baseline groups, balanced by cost. Pure integers, no MPI."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray, IntArray


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

    Times are cut first, since the basis is evaluated once a time whatever the number of baselines; baseline
    groups are cut too only where there are more ranks than times.

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
    groups = np.unique(group)
    n_time_parts = min(n_ranks, len(times)) if len(times) else 1
    n_group_parts = min(max(n_ranks // n_time_parts, 1), max(len(groups), 1))
    tiles = []
    for part in split_by_cost(np.asarray(time_costs, dtype=float), n_time_parts):
        for group_part in split_by_cost(np.ones(len(groups)), n_group_parts):
            mine = np.isin(group, groups[group_part])
            tiles.append(Tile(times[part], bls[mine]))
    empty = Tile(times[:0], bls[:0])
    return tiles + [empty] * (n_ranks - len(tiles))
