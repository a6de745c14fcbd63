"""Who has which rows on a number of ranks, and what a step on them takes the slowest."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hydrabeam_mpi.data.partition import Tile, make_tiles
from hydrabeam_mpi.fit.coupled import dense_unknowns
from hydrabeam_mpi.fit.memory import Share
from hydrabeam_mpi.loop.checks.conventions import sample_times
from hydrabeam_mpi.memory import machine_bytes
from hydrabeam_mpi.mpi.grid import ranks_of_groups
from hydrabeam_mpi.planning.measure import Cost
from hydrabeam_mpi.planning.outline import Outline


@dataclass(frozen=True)
class Partition:
    """How the work is shared out.

    Attributes
    ----------
    groups, ranks_per_group : int
        Groups of ranks, and how many there are in the smallest.
    channels : int
        Of the group that has most.
    times, baseline_groups : int
        Of the slowest rank: those that it fits, or simulates.
    imbalance : float
        By how much the slowest rank of a group has more to do than the mean, as a fraction.
    """

    groups: int
    ranks_per_group: int
    channels: int
    times: int
    baseline_groups: int
    imbalance: float


@dataclass(frozen=True)
class Simulated:
    """Who simulates which times, on a number of ranks: each all channels and groups."""

    outline: Outline
    ranks: int

    @cached_property
    def _loads(self) -> list[tuple[float, int]]:
        """What the times of each rank cost, and how many they are."""
        costs, alone = self.outline.relative_costs, np.zeros(1, dtype=int)
        tiles = make_tiles(np.arange(len(costs)), costs, alone, alone, min(self.ranks, len(costs)))
        return [(self.outline.times_of(tile), len(tile.times)) for tile in tiles]

    @property
    def slowest(self) -> float:
        """What the times of the slowest rank cost; see `Outline.times_of`."""
        return max(self._loads)[0]

    @property
    def partition(self) -> Partition:
        """How the times are shared out."""
        mean = sum(load for load, _ in self._loads) / len(self._loads)
        slowest, n_times = max(self._loads)
        n_groups = self.outline.problem.redundant.Ngroups
        imbalance = slowest / mean - 1 if mean else 0.0
        return Partition(1, self.ranks, self.outline.n_channels, n_times, n_groups, imbalance)


class Shares:
    """Who has which rows, on a number of ranks."""

    def __init__(self, outline: Outline, ranks: int) -> None:
        self.outline, self.ranks = outline, ranks
        self.n_groups = min(ranks, outline.n_channels)
        self.in_group = min(ranks_of_groups(ranks, outline.n_channels))
        self.channels = -(-outline.n_channels // self.n_groups)
        self.train, self.test = (self._tiles(rows) for rows in (outline.problem.train, outline.problem.test))

    def _tiles(self, rows: Tile) -> list[Tile]:
        problem = self.outline.problem
        costs = problem.time_costs[rows.times]
        return make_tiles(rows.times, costs, rows.bls, problem.redundant.group[rows.bls], self.in_group)

    def groups_of(self, tile: Tile) -> int:
        """Return how many redundant groups a tile has."""
        return len(np.unique(self.outline.problem.redundant.group[tile.bls]))

    def seconds(self, cost: Cost, test: bool = False, most: int | None = None) -> float:
        """Return the seconds of the slowest rank in which a step is done with its rows of all its channels.

        It is one of held-out rows with ``test``, and one of so many times at ``most``, evenly spread over the run's.
        """
        tiles = self.test if test else self.train
        if most is not None:
            times = sample_times(self.outline.problem.train.times, most)
            tiles = [replace(tile, times=np.intersect1d(tile.times, times)) for tile in tiles]
        sizes = ((self.outline.times_of(tile) if tile.size else 0.0, self.groups_of(tile)) for tile in tiles)
        return max(cost.seconds(*size, self.channels) for size in sizes)

    @cached_property
    def largest(self) -> Tile:
        """The fitted rows of the rank that has most."""
        return max(self.train, key=lambda tile: self.outline.times_of(tile) * self.groups_of(tile))

    @cached_property
    def partition(self) -> Partition:
        """How the rows are shared out."""
        loads = [self.outline.times_of(tile) * self.groups_of(tile) for tile in self.train]
        imbalance = max(loads) / (sum(loads) / len(loads)) - 1 if sum(loads) else 0.0
        tile = self.largest
        return Partition(self.n_groups, self.in_group, self.channels, len(tile.times), self.groups_of(tile), imbalance)

    @cached_property
    def share(self) -> Share:
        """Sizes of the share of the rank that has most."""
        most = max(self.test, key=lambda tile: tile.size)
        share = Share.of(self.outline.problem, self.channels, self.largest, most, memory_of(self.ranks))
        return replace(share, unknowns=dense_unknowns(self.outline.coupling, share.basis.n_modes))


def memory_of(ranks: int) -> int:
    """Return the bytes that a rank has on machines like this one, with a rank a core or fewer."""
    return machine_bytes() // min(ranks, os.cpu_count() or 1)
