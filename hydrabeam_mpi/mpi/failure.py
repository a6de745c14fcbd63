"""Failing together: when one rank fails, all ranks raise the error."""

from __future__ import annotations

import pickle
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

FIRST_PAUSE, LONGEST_PAUSE = 1e-4, 2e-3
"""Seconds; who has waited for that long sleeps for that long, and then for twice as long."""


@dataclass(frozen=True)
class Shared:
    """What a rank knows of an exception that `together` raised on several.

    Attributes
    ----------
    n_ranks : int
        On how many.
    speaks : bool
        Whether this is the one rank among them that tells of it.
    """

    n_ranks: int
    speaks: bool


_MARK = "_hydrabeam_shared"


def how_shared(error: BaseException) -> Shared:
    """Return on how many ranks ``error`` was raised together: one, where `together` did not see it."""
    return getattr(error, _MARK, Shared(n_ranks=1, speaks=True))


def share(error: BaseException, shared: Shared) -> None:
    """Note with an exception on how many ranks it was raised, and which of them tells of it."""
    setattr(error, _MARK, shared)


@contextmanager
def together(comm: MPI.Comm) -> Iterator[None]:
    """Run a block of local work; if it fails on any rank, raise on all. Collective: all ranks of `comm`.

    All ranks leave the block by the same way: normally, or with the exception of the first rank that failed.
    So no rank waits in a later collective for one that is gone, and one rank can speak for all. In the block
    itself no rank may wait for another of `comm`, which may already have failed.

    Parameters
    ----------
    comm : mpi4py.MPI.Comm

    Raises
    ------
    Exception
        What the lowest failing rank raised. The other ranks get a copy, with the traceback as a note; a
        `RuntimeError` with type and message in its place if it cannot be pickled.
    """
    error: Exception | None = None
    try:
        yield
    except Exception as caught:
        error = caught
    first = _lowest(comm, comm.size if error is None else comm.rank)
    if first == comm.size:
        return
    copy: Exception = comm.bcast(_portable(error, first) if error and comm.rank == first else None, first)
    if error is None or comm.rank != first:
        error = copy
    share(error, Shared(n_ranks=comm.size, speaks=comm.rank == first))
    raise error


def _lowest(comm: MPI.Comm, number: int) -> int:
    """Return the lowest number of all ranks; one that waits long for others sleeps, so that they have its core."""
    mine, lowest = np.array([number]), np.zeros(1, dtype=int)
    request, pause = comm.Iallreduce(mine, lowest, MPI.MIN), FIRST_PAUSE
    began = time.perf_counter()
    while not request.Test():
        if time.perf_counter() - began > pause:
            time.sleep(pause)
            pause = min(2 * pause, LONGEST_PAUSE)
    return int(lowest[0])


def _portable(error: Exception, rank: int) -> Exception:
    """Copy of ``error`` that survives the way to another rank and tells where it comes from."""
    try:
        copy: Exception = pickle.loads(pickle.dumps(error))
    except Exception:
        copy = RuntimeError(f"{type(error).__name__}: {error}")
    copy.add_note(f"Raised on rank {rank}:\n" + "".join(traceback.format_exception(error)).rstrip())
    return copy
