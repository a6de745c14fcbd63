"""Parts of an array on another rank."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from hydrabeam_mpi.mpi import OneSided, free_windows


@pytest.mark.mpi
@pytest.mark.parametrize("dtype", [complex, bool, np.float32])
def test_all_ranks_get_the_parts_that_they_ask_for(comm: MPI.Comm, dtype: type) -> None:
    array = np.random.default_rng(2).normal(size=(30, 7, 2)).astype(dtype)
    # A view of another array, whose rows do not lie side by side.
    shared = OneSided(comm, np.repeat(array, 2, axis=1)[:, ::2] if comm.rank == 0 else None)
    assert shared.shape == array.shape
    rows = np.array([29, comm.rank, 4])
    np.testing.assert_array_equal(shared.get(rows, slice(comm.rank, 6)), array[rows, comm.rank : 6])
    assert shared.get(rows[:0], slice(0, 7)).shape == (0, 7, 2)
    free_windows(comm)
