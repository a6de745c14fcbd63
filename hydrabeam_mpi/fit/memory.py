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
from hydrabeam_mpi.fit.room import COMPLEX, PART_KEPT, REAL, Room
from hydrabeam_mpi.fit.rounding import TIMES_IN_DOUBLE
from hydrabeam_mpi.fit.row_buffer import CAPACITY
from hydrabeam_mpi.memory import own_bytes
from hydrabeam_mpi.model.bases.base import LinearBasis
from hydrabeam_mpi.model.engines.base import SOURCES_AT_ONCE
from hydrabeam_mpi.mpi import ProcessGrid, memory_per_rank, together
from hydrabeam_mpi.setup.problem import Problem
from hydrabeam_mpi.words import counted, size

PER_VISIBILITY = 25
"""Bytes of a visibility that is kept, with its weight and flag."""
READING = 3
"""Times what is kept, while it is read."""
LOOKED_AT = 160
"""Bytes of a sample of the health check: data, model, weights, and sums of them beside each other."""
FITTED = 190
"""Bytes of a visibility for a fit: calibrated by effects, with what these add, and of held-out ones what two fits leave
and how well it is known: 73 bytes for each of the two (`heldout.Whitened`), of which half of all are held out."""
WHITENED = 4
"""Roots of the covariance of the predictions of one time that are there at once: as made, scaled, and its vectors."""
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
    kept_bytes : float
        That a design may take, to be kept.
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
    kept_bytes: float = np.inf

    @classmethod
    def of(cls, problem: Problem, channels: int, train: Tile, test: Tile, memory: float) -> Share:
        """Return the sizes of a rank's tiles in so many channels, where a rank has so much ``memory``, in bytes."""
        groups = np.unique(problem.redundant.group[np.union1d(train.bls, test.bls)])
        n_bls = max(len(train.bls), len(test.bls))
        watched = min(TIMES_IN_DOUBLE, len(train.times)) if problem.job.solver.precision == "mixed" else 0
        sizes = channels, len(train.times), len(test.times), n_bls, len(groups), problem.sky.Nsrc
        return cls(*sizes, problem.basis, watched, kept_bytes=PART_KEPT * memory)

    def room(self, n_times: int) -> Room:
        """Return what is kept of so many of its times."""
        return Room.of(n_times, self.groups, self.channels, self.basis.n_modes, self.sources, self.kept_bytes)

    @property
    def visibilities(self) -> int:
        """Number of those of its rows."""
        return self.channels * (self.train_times + self.test_times) * self.baselines

    @property
    def kept_designs(self) -> int:
        """Bytes of the designs that are kept of fitted and of held-out rows, of one sky."""
        return sum(times * self.design for times in (self.train_times, self.test_times) if self.room(times).designs)

    @property
    def kept_waves(self) -> int:
        """Bytes of the fringes of sources above the horizon, half of all, kept of fitted and of held-out rows."""
        each = self.sources // 2 * self.groups * 2 * REAL * self.channels
        return sum(times * each for times in (self.train_times, self.test_times) if self.room(times).waves)

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
        # Columns of real coefficients are the design.
        mixed = self.design if self.basis.is_complex else 0
        return at_once + self.channels * self.groups * self.basis.n_columns * COMPLEX + mixed

    @property
    def kept(self) -> int:
        """Bytes of the rows."""
        return PER_VISIBILITY * self.visibilities


def simulation_bytes(n_rows: int, n_channels: int) -> int:
    """Return the bytes of simulated data on rank 0: of visibilities with noise and as written, and of what each row is.

    Of each row, a baseline at a time, pyuvdata keeps two dozen numbers.
    """
    return n_rows * (90 * n_channels + 300)


def inference_bytes(share: Share, root: bool) -> int:
    """Return the bytes that a rank needs for an inference; of its group's ``root`` more than of others."""
    return max(_reading(share), share.kept + _inferring(share, root))


def joint_bytes(share: Share, root: bool) -> int:
    """Return the bytes that a rank needs for a fit with effects, or for chains: their designs are kept if they fit."""
    return fit_bytes(share, root) + 2 * share.kept_designs


def fit_bytes(share: Share, root: bool, besides: int = 0) -> int:
    """Return the bytes that a rank needs to fit and to check a fit, or where that is more for something ``besides``."""
    held = share.kept + FITTED * share.visibilities + share.kept_designs + share.kept_waves
    # Of beams that hang together, how they follow effects: columns of their matrix, twice solved for.
    following = 3 * share.item * share.unknowns * min(share.unknowns, MAX_PARAMETERS)
    # While widths are adapted: what the data say of the beams of its channels, a matrix, its factor and its inverse.
    adapting = (share.channels + 3) * share.matrix if root else 0
    working = max(_inferring(share, root) + max(following, adapting), _whitening(share), besides)
    return max(_reading(share), held + working)


def _reading(share: Share) -> int:
    """Return the bytes of the rows while their health is looked at, or while they are read."""
    rows = max(share.train_times, share.test_times) * share.baselines * share.channels
    return max(LOOKED_AT * share.visibilities, share.kept + (READING - 1) * PER_VISIBILITY * rows)


def _inferring(share: Share, root: bool) -> int:
    """Return the bytes that an inference needs besides the rows."""
    # Designs wait for others where they have few rows; together they are copied, and weighted.
    of_rows = share.basis.n_modes * COMPLEX
    buffered = share.channels * CAPACITY * of_rows if share.groups < CAPACITY else 0
    flushed = (4 if share.basis.is_complex else 3) * max(CAPACITY, share.groups) * of_rows // 2
    watched = share.watched_times * share.design
    summing = share.making_design + buffered + flushed + share.channels * share.matrix + watched
    solved = 2 * share.channels * share.matrix
    # The matrix of all channels, and its inverse.
    solving = solved + 2 * share.item * share.unknowns**2 + watched
    checking = share.making_design + 2 * share.design // share.channels + solved
    describing = solved + (share.channels + DESCRIBED) * share.matrix if root else solved
    return max(summing, solving, checking, describing)


def _whitening(share: Share) -> int:
    """Return the bytes in which the held-out rows of one time are whitened, besides what is kept."""
    parts, coefficients = 2 * share.groups, share.basis.n_modes * (1 + share.basis.is_complex)
    roots = WHITENED * REAL * parts * min(parts, coefficients)
    made = 0 if share.room(share.test_times).designs else share.making_design
    return roots + made + 2 * share.channels * share.matrix


Needed = Callable[[Problem, Share, bool], int]
"""Tells how many bytes a share of a problem needs on a rank, of which the last is whether it is its group's root."""


def of_share(needed: Callable[[Share, bool], int]) -> Needed:
    """Return what a share needs whatever the problem is otherwise."""
    return lambda _, share, root: needed(share, root)


def check_room(grid: ProcessGrid, problems: Sequence[Problem], needed: Needed) -> None:
    """Refuse a run that does not fit the memory, before it begins.

    Collective: all ranks of `grid.world`.

    Parameters
    ----------
    grid : ProcessGrid
    problems : sequence of Problem
        Of all channels, one a polarisation. What each needs counts, though they share the design.
    needed : callable
        `inference_bytes` or `joint_bytes`, by `of_share`, or `loop.memory.loop_bytes`.

    Raises
    ------
    InputError
        On all ranks, if it needs more than a rank has, or the job's channels cannot be solved for together.
    """
    rows, own, memory = problems[0], own_bytes(), memory_per_rank(grid.world)
    train, test = (rows.tile_of(some, grid.group.rank, grid.group.size) for some in (rows.train, rows.test))
    for problem in problems:
        share = Share.of(problem, len(grid.channels), train, test, memory)
        with together(grid.world):
            unknowns = dense_unknowns(problem.coupling, problem.basis.n_modes)
            share = replace(share, unknowns=unknowns if grid.is_world_root else 0)
            own += needed(problem, share, grid.is_group_root)
    most = max(grid.world.allgather(own))
    with together(grid.world):
        check_fits(most, memory, grid.world.size, bool(dense_unknowns(rows.coupling, rows.basis.n_modes)))


def check_fits(needed: int, memory: int, n_ranks: int, as_one: bool = False) -> None:
    """Refuse what does not fit.

    Parameters
    ----------
    needed, memory : int
        Bytes that a rank needs, and has.
    n_ranks : int
    as_one : bool
        Whether rank 0 solves for the beams of all channels as one matrix.

    Raises
    ------
    InputError
        If it needs more.
    """
    if needed <= memory:
        return
    remedy = "use more nodes, with fewer ranks on each, or fewer modes ([basis] n_modes)"
    if as_one:
        remedy = (
            "rank 0 solves for all channels as one matrix, on any number of ranks: set [prior.frequency] solver = "
            '"conjugate-gradients", a longer length or fewer modes along frequency, or fewer modes ([basis] n_modes)'
        )
    raise InputError(
        f"needs {size(needed)} a rank on {counted(n_ranks, 'rank')}, and a rank has {size(memory)}",
        remedy=f"{remedy} ('hydrabeam plan' tells what other numbers of ranks need)",
    )
