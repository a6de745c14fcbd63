"""Which ranks treat which channels."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from mpi4py import MPI

from hydrabeam_mpi.mpi.threads import more_threads, threads_of_roots


def alone() -> MPI.Comm:
    """Return the communicator of this process alone."""
    return MPI.COMM_SELF


def _block(index: int, n_blocks: int, n_items: int) -> range:
    """Block ``index`` of ``n_items`` cut into ``n_blocks`` runs, whose lengths differ by at most one."""
    return range(index * n_items // n_blocks, (index + 1) * n_items // n_blocks)


def ranks_of_groups(n_ranks: int, n_channels: int) -> list[int]:
    """Return how many ranks each group has where so many ranks treat so many channels."""
    n_groups = min(n_ranks, n_channels)
    return [len(_block(group, n_groups, n_ranks)) for group in range(n_groups)]


@dataclass(frozen=True)
class ProcessGrid:
    """The ranks of a run laid out as groups: each group treats its own channels, its ranks share their rows.

    There are as many groups as channels where the ranks suffice, else one rank a group with several channels.
    Groups are runs of neighbouring ranks, so that a group stays on as few nodes as possible; its channels are
    neighbours too, so that it reads contiguous parts of a file.

    Attributes
    ----------
    world : mpi4py.MPI.Comm
        All ranks.
    group : mpi4py.MPI.Comm
        The ranks of this rank's group.
    group_index, n_groups : int
        Which group this is, of how many.
    n_channels : int
        Number of channels of the job.
    root_threads : int
        Threads of BLAS that this rank may use, if it is a group's root, while the other ranks wait.
    """

    world: MPI.Comm
    group: MPI.Comm
    group_index: int
    n_groups: int
    n_channels: int
    root_threads: int

    @classmethod
    def split(cls, world: MPI.Comm, n_channels: int) -> ProcessGrid:
        """Lay out the ranks of ``world`` for one channel or more. Collective: all ranks of `world`."""
        if n_channels < 1:
            raise ValueError(f"a process grid needs at least one channel, not {n_channels}")
        n_groups = min(world.size, n_channels)
        group_index = next(g for g in range(n_groups) if world.rank in _block(g, n_groups, world.size))
        group = world.Split(group_index, world.rank)
        root_threads = threads_of_roots(world, group.rank == 0)
        return cls(world, group, group_index, n_groups, n_channels, root_threads)

    @property
    def channels(self) -> range:
        """Indices of the channels that this rank's group treats."""
        return _block(self.group_index, self.n_groups, self.n_channels)

    @property
    def is_world_root(self) -> bool:
        """Whether this rank speaks and writes for the run."""
        return self.world.rank == 0

    @property
    def is_group_root(self) -> bool:
        """Whether this rank solves for its group."""
        return self.group.rank == 0

    @contextmanager
    def roots_alone(self) -> Iterator[None]:
        """Give the cores of all ranks of a node to its groups' roots, for what these do while the others sleep."""
        if not self.is_group_root:
            yield
            return
        with more_threads(self.root_threads):
            yield

    def root_of(self, channel: int) -> int:
        """Rank in `world` of the group root that treats ``channel``."""
        group = next(g for g in range(self.n_groups) if channel in _block(g, self.n_groups, self.n_channels))
        return _block(group, self.n_groups, self.world.size).start
