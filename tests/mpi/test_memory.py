from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from hydrabeam_mpi.mpi import peak_rss_mb

pytestmark = pytest.mark.mpi


def test_the_largest_rank_counts_and_a_peak_stays(comm: MPI.Comm) -> None:
    before = peak_rss_mb(comm)
    if comm.rank == comm.size - 1:
        np.ones(25_000_000)  # 200 MB, gone at once
    after = peak_rss_mb(comm)
    assert comm.allgather(after) == [after] * comm.size
    assert before + 150 < after < before + 350
