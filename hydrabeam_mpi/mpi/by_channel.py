"""What rank groups have of their channels, brought to one rank, and what that rank has of all of them brought back."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TypeVar

from mpi4py import MPI

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
    return list(by_channel(grid, records))


def by_channel(grid: ProcessGrid, records: list[T]) -> Iterator[T]:
    """Do as `gather_by_channel`, but yield them on rank 0, so that not all need be there at one time.

    Collective: all ranks of `grid.world`, to the end.
    """
    if grid.is_world_root:
        yield from records
        for channel in range(len(records), grid.n_channels):
            yield recv_object(grid.world, grid.root_of(channel))
    else:
        for record in records:
            send_object(grid.world, record, dest=0)


def share_by_channel(grid: ProcessGrid, records: Iterable[T]) -> list[T]:
    """Bring records of all channels, those of rank 0, to the roots of the groups that treat them, one after the other.

    Collective: all ranks of `grid.world`.

    Returns
    -------
    list
        Of the group's channels, on the group's root; empty on other ranks.
    """
    if not grid.is_world_root:
        return [recv_object(grid.world, 0) for _ in grid.channels] if grid.is_group_root else []
    kept = []
    for channel, record in enumerate(records):
        if channel in grid.channels:
            kept.append(record)
        else:
            send_object(grid.world, record, grid.root_of(channel))
    return kept


def roots_of(grid: ProcessGrid) -> MPI.Comm | None:
    """Return the groups' roots, in the order of their channels; None on other ranks. Collective: all ranks."""
    comm = grid.world.Split(0 if grid.is_group_root else MPI.UNDEFINED, grid.world.rank)
    return comm if grid.is_group_root else None
