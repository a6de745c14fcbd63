"""What rank groups have of their channels, brought to one rank."""

from __future__ import annotations

from typing import TypeVar

from hydrabeam_mpi.mpi.collectives import recv_object, send_object
from hydrabeam_mpi.mpi.grid import ProcessGrid

T = TypeVar("T")


def gather_by_channel(grid: ProcessGrid, records: list[T]) -> list[T]:
    """Bring the channels' records to rank 0, one after the other.

    Collective: all ranks of `grid.world`.

    Parameters
    ----------
    grid : ProcessGrid
    records : list
        Of the group's channels, on the group's root; empty on other ranks.

    Returns
    -------
    list
        Of all channels, on rank 0; empty on other ranks.
    """
    if grid.is_world_root:
        elsewhere = range(len(records), grid.n_channels)
        return records + [recv_object(grid.world, grid.root_of(channel)) for channel in elsewhere]
    for record in records:
        send_object(grid.world, record, dest=0)
    return []
