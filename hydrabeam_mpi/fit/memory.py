"""How much memory a rank's share of a job needs besides the programs and the problem itself.

Counted are the arrays that are there at one time, from the sizes in the docstrings of what makes them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hydrabeam_mpi.data.partition import Tile
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.fit.coupled import dense_unknowns
from hydrabeam_mpi.fit.coupled_step import MAX_PARAMETERS
from hydrabeam_mpi.fit.rounding import TIMES_IN_DOUBLE
from hydrabeam_mpi.fit.row_buffer import CAPACITY
from hydrabeam_mpi.fit.row_model import KEPT_BYTES
from hydrabeam_mpi.memory import own_bytes
from hydrabeam_mpi.model.bases.base import LinearBasis
from hydrabeam_mpi.model.engines.base import SOURCES_AT_ONCE
from hydrabeam_mpi.mpi import ProcessGrid, memory_per_rank, together
from hydrabeam_mpi.setup.problem import Problem

REAL, COMPLEX = 8, 16
PER_VISIBILITY = 25
"""Bytes of a visibility that is kept, with its weight and flag."""
READING = 3
"""Times what is kept, while it is read."""
LOOKED_AT = 160
"""Bytes of a sample of the health check: data, model, weights, and sums of them beside each other."""
DESCRIBED = 6
"""Matrices of the coefficients' size that are there at once when a channel is described, its posterior among them."""


@dataclass(frozen=True)
class Share:
    """Sizes of a rank's share.

    Attributes
    ----------
    channels : int
        That the rank's group treats.
    train_times, test_times, baselines, groups : int
        Of its rows.
    sources : int
        Of the whole sky.
    basis : LinearBasis
    watched_times : int
        Whose designs are kept to tell of rounding errors.
    unknowns : int
        Solved for as one matrix of all channels, on this rank.
    """

    channels: int
    train_times: int
    test_times: int
    baselines: int
    groups: int
    sources: int
    basis: LinearBasis
    watched_times: int = 0
    unknowns: int = 0

    @classmethod
    def of(cls, problem: Problem, channels: int, train: Tile, test: Tile) -> Share:
        """Return the sizes of a rank's tiles in so many channels."""
        groups = np.unique(problem.redundant.group[np.union1d(train.bls, test.bls)])
        n_bls = max(len(train.bls), len(test.bls))
        watched = min(TIMES_IN_DOUBLE, len(train.times)) if problem.job.solver.precision == "mixed" else 0
        sizes = channels, len(train.times), len(test.times), n_bls, len(groups), problem.sky.Nsrc
        return cls(*sizes, problem.basis, watched)

    @property
    def item(self) -> int:
        """Bytes of a coefficient."""
        return COMPLEX if self.basis.is_complex else REAL

    @property
    def matrix(self) -> int:
        """Bytes of a matrix of the coefficients' size."""
        return self.basis.n_modes**2 * self.item

    @property
    def design(self) -> int:
        """Bytes of the design of one time in all channels."""
        return self.channels * self.groups * self.basis.n_modes * COMPLEX

    @property
    def making_design(self) -> int:
        """Bytes in which the design of one time is made: columns, fringes of a chunk of sources, their product."""
        at_once = SOURCES_AT_ONCE * REAL * (self.basis.n_columns + 3 * self.groups)
        return at_once + self.channels * self.groups * self.basis.n_columns * COMPLEX + self.design

    @property
    def kept(self) -> int:
        """Bytes of the rows."""
        return PER_VISIBILITY * self.channels * (self.train_times + self.test_times) * self.baselines


def simulation_bytes(n_rows: int, n_channels: int) -> int:
    """Return the bytes of simulated data on rank 0: of visibilities with noise and as written, and of what each row is.

    Of each row, a baseline at a time, pyuvdata keeps two dozen numbers.
    """
    return n_rows * (90 * n_channels + 300)


def inference_bytes(share: Share, root: bool) -> int:
    """Return the bytes that a rank needs for an inference; of its group's ``root`` more than of others."""
    rows = max(share.train_times, share.test_times) * share.baselines * share.channels
    reading = share.kept + (READING - 1) * PER_VISIBILITY * rows
    looking = LOOKED_AT * share.channels * (share.train_times + share.test_times) * share.baselines
    buffered = share.channels * max(CAPACITY, share.groups) * share.basis.n_modes * COMPLEX
    flushed = 2 * buffered // share.channels
    watched = share.watched_times * share.design
    summing = share.making_design + buffered + flushed + share.channels * share.matrix + watched
    solved = 2 * share.channels * share.matrix
    # The matrix of all channels, and its inverse.
    solving = solved + 2 * share.item * share.unknowns**2 + watched
    checking = share.making_design + 2 * share.design // share.channels + solved
    describing = solved + (share.channels + DESCRIBED) * share.matrix if root else solved
    return max(looking, reading, share.kept + max(summing, solving, checking, describing))


def loop_bytes(share: Share, root: bool) -> int:
    """Return the bytes that a rank needs for a loop, or for chains: designs and waves of sources are kept if they fit.

    Effects' columns are as many as those of the beam at most; see `RULES.most_columns`.
    """
    kept = sum(
        design for times in (share.train_times, share.test_times) if 2 * (design := times * share.design) <= KEPT_BYTES
    )
    waves = share.sources * share.train_times * share.groups * REAL * share.channels
    # Those of the rows and of the blocks that effects see of them, of effects' columns, and of a larger basis. Measured
    # in the paper's case: 1.6 GB, of which this is three fifths.
    of_rows = 4 * kept + (4 * waves if waves <= KEPT_BYTES / 4 else 0)
    # Of beams that hang together, how they follow effects: columns of their matrix, twice solved for.
    following = 3 * share.item * share.unknowns * min(share.unknowns, MAX_PARAMETERS)
    # While widths are adapted: what the data say of the beams of its channels, a matrix, its factor and its inverse.
    adapting = (share.channels + 3) * share.matrix if root else 0
    return inference_bytes(share, root) + of_rows + max(following, adapting)


def check_room(grid: ProcessGrid, problems: Sequence[Problem], needed: Callable[[Share, bool], int]) -> None:
    """Refuse a run that does not fit the memory, before it begins.

    Collective: all ranks of `grid.world`.

    Parameters
    ----------
    grid : ProcessGrid
    problems : sequence of Problem
        Of all channels, one a polarisation. What each needs counts, though they share the design.
    needed : callable
        `inference_bytes` or `loop_bytes`.

    Raises
    ------
    InputError
        On all ranks, if it needs more than a rank has, or the job's channels cannot be solved for together.
    """
    rows, own = problems[0], own_bytes()
    tiles = [rows.tile_of(some, grid.group.rank, grid.group.size) for some in (rows.train, rows.test)]
    for problem in problems:
        share = Share.of(problem, len(grid.channels), *tiles)
        with together(grid.world):
            unknowns = dense_unknowns(problem.coupling, problem.basis.n_modes)
            share = replace(share, unknowns=unknowns if grid.is_world_root else 0)
        own += needed(share, grid.is_group_root)
    most = max(grid.world.allgather(own))
    memory = memory_per_rank(grid.world)
    with together(grid.world):
        check_fits(most, memory, grid.world.size)


def check_fits(needed: int, memory: int, n_ranks: int) -> None:
    """Refuse what does not fit.

    Parameters
    ----------
    needed, memory : int
        Bytes that a rank needs, and has.
    n_ranks : int

    Raises
    ------
    InputError
        If it needs more.
    """
    if needed > memory:
        raise InputError(
            f"needs {needed / 1e9:.3g} GB a rank on {n_ranks} ranks, and a rank has {memory / 1e9:.3g} GB",
            remedy="use more nodes, with fewer ranks on each, or fewer modes ([basis] n_modes)"
            " ('hydrabeam plan' tells what other numbers of ranks need)",
        )
