"""The columns of effects at the rows of one time after the other."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from scipy.sparse import csr_array, hstack

from hydrabeam_mpi.data.observation import IntArray
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.fit.state import Active

Parts = Sequence[tuple[Any, bool]]
"""For each effect a matrix of its parameters in use, dense or sparse, and whether its rows are redundant groups."""


def columns_by_time(block: RowBlock, active: Sequence[Active], channel: int) -> Iterator[Parts]:
    """Yield the columns of effects in a channel of the job, for each of the block's times."""
    block.integrate_for([one.effect for one in active])
    made = [(block.columns_of(one.effect, one.x[channel]), one.used) for one in active]
    matrices = [(one.matrix()[:, used], one.by_group) for one, used in made]
    n_times = len(block.times)
    for t in range(n_times):
        rows = [matrix.shape[0] // n_times for matrix, _ in matrices]
        yield [(matrix[t * n : (t + 1) * n], of) for (matrix, of), n in zip(matrices, rows, strict=True)]


def of_baselines(parts: Parts, member: IntArray) -> csr_array:
    """Return the columns of all effects side by side at each baseline of a time; groups are those of ``member``."""
    each = ((csr_array(matrix), of_groups) for matrix, of_groups in parts)
    return hstack([matrix[member] if of_groups else matrix for matrix, of_groups in each], format="csr")
