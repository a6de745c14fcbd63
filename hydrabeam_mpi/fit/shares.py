"""A rank's share of the rows to infer from and of those held out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydrabeam_mpi.data.partition import Tile
from hydrabeam_mpi.fit.rows import Rows, read_rows_of_each
from hydrabeam_mpi.fit.shared_design import leader
from hydrabeam_mpi.io.noise import check_weights
from hydrabeam_mpi.mpi import ProcessGrid, allreduce_sum, together
from hydrabeam_mpi.setup.problem import Problem


def read_shares(grid: ProcessGrid, problem: Problem, whole_times: bool = False) -> tuple[Rows, Rows]:
    """Read the rank's training and held-out rows; ``whole_times`` keeps held-out rows of the same time together.

    Collective: all ranks of `grid.world`.
    """
    (train,), (test,) = read_shares_of_each(grid, [problem], whole_times)
    return train, test


def read_shares_of_each(
    grid: ProcessGrid, problems: Sequence[Problem], whole_times: bool = False
) -> tuple[list[Rows], list[Rows]]:
    """Read the rows of several polarisations, as `read_shares` does of one. Collective: all ranks of `grid.world`."""
    train, test = problems[0].train, problems[0].test
    return _read_share(grid, problems, train), _read_share(grid, problems, test, whole_times, must_count=False)


def read_share(
    grid: ProcessGrid, problem: Problem, rows: Tile, whole_times: bool = False, must_count: bool = True
) -> Rows:
    """Read the rank's share of some rows, some of which ``must_count``. Collective: all ranks of `grid.world`."""
    return _read_share(grid, [problem], rows, whole_times, must_count)[0]


def _read_share(
    grid: ProcessGrid, problems: Sequence[Problem], rows: Tile, whole_times: bool = False, must_count: bool = True
) -> list[Rows]:
    with together(grid.world):
        # With the fewest groups: none of the others' is torn.
        tile = problems[leader(problems)].tile_of(rows, grid.group.rank, grid.group.size, whole_times)
        mine = read_rows_of_each(problems, tile)
    counts = np.array([(one.n_unflagged, np.count_nonzero(one.inv_noise_var)) for one in mine])
    allreduce_sum(grid.world, counts)
    with together(grid.world):
        for n_unflagged, n_weighted in counts.tolist() if must_count else ():
            check_weights(n_unflagged, n_weighted, problems[0].files)
    return mine
