from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from hydrabeam_mpi.mpi import ProcessGrid

pytestmark = pytest.mark.mpi


@pytest.mark.parametrize("n_channels", [1, 2, 3, 4, 7])
def test_every_channel_has_one_group_and_every_rank_a_place(comm: MPI.Comm, n_channels: int) -> None:
    grid = ProcessGrid.split(comm, n_channels)
    places = comm.allgather((grid.group_index, grid.group.rank, grid.group.size, list(grid.channels)))

    assert grid.n_groups == min(comm.size, n_channels)
    assert [place[0] for place in places] == sorted(place[0] for place in places)
    roots = [place for place in places if place[1] == 0]
    assert [root[0] for root in roots] == list(range(grid.n_groups))
    assert [channel for root in roots for channel in root[3]] == list(range(n_channels))
    for sizes in ([root[2] for root in roots], [len(root[3]) for root in roots]):
        assert min(sizes) >= 1
        assert np.ptp(sizes) <= 1
    assert sum(root[2] for root in roots) == comm.size
    assert all(place[3] == roots[place[0]][3] for place in places)


@pytest.mark.parametrize("n_channels", [1, 2, 5])
def test_roots(comm: MPI.Comm, n_channels: int) -> None:
    grid = ProcessGrid.split(comm, n_channels)
    assert grid.is_world_root == (comm.rank == 0)
    assert grid.is_group_root == (grid.group.rank == 0)
    mine = {channel for channel in range(n_channels) if grid.root_of(channel) == comm.rank}
    assert mine == (set(grid.channels) if grid.is_group_root else set())


def test_groups_sum_apart(comm: MPI.Comm) -> None:
    grid = ProcessGrid.split(comm, 2)
    assert grid.group.allreduce(1) == grid.group.size
    assert comm.allreduce(1 if grid.is_group_root else 0) == grid.n_groups


def test_no_channels(comm: MPI.Comm) -> None:
    with pytest.raises(ValueError, match="at least one channel, not 0"):
        ProcessGrid.split(comm, 0)
