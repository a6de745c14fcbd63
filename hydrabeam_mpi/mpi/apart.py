"""Groups of ranks that work each for itself: one that fails tells the others at once."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from mpi4py import MPI


class FailedElsewhere(Exception):
    """Another group of ranks has failed, and tells of it."""


@contextmanager
def apart(world: MPI.Comm, group: MPI.Comm) -> Iterator[Callable[[], None]]:
    """Run a block of a group's work; if it fails in any group, all others end theirs when they next listen.

    What is yielded is to be called now and then by rank 0 of the group, within `together`, whose other ranks it ends
    then, too: it raises `FailedElsewhere` where another group has failed. That ends here: only the group that failed
    leaves with its error. Groups that come to the end wait for the others. Collective: all ranks of `world`.

    Parameters
    ----------
    world, group : mpi4py.MPI.Comm
        All ranks, and those of this one's group.

    Raises
    ------
    Exception
        What the block of this rank's group raised; on all ranks of the group, if that was `together`.
    """
    # Its own messages, which nobody else takes for theirs.
    comm = world.Dup()
    heads = [rank for rank, leads in enumerate(comm.allgather(group.rank == 0)) if leads]
    leads = group.rank == 0

    def listen() -> None:
        if comm.Iprobe(MPI.ANY_SOURCE):
            raise FailedElsewhere

    error: Exception | None = None
    try:
        yield listen
    except FailedElsewhere:
        pass
    except Exception as caught:
        error = caught
    told = [comm.isend(None, head) for head in heads if head != comm.rank] if leads and error is not None else []
    for head in [head for head, failed in enumerate(comm.allgather(leads and error is not None)) if failed]:
        if leads and head != comm.rank:
            comm.recv(source=head)
    MPI.Request.Waitall(told)
    comm.Free()
    if error is not None:
        raise error
