"""Threads of BLAS and OpenMP: as many as there are cores for this rank."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from functools import cache

import numpy as np
import threadpoolctl
from mpi4py import MPI

# threadpoolctl sees loaded libraries only. One that scipy may bring reads the environment when it is loaded.
_LOADED = (np.linalg,)
_USER_SETTINGS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_shared_out: set[int] = set()
"""This rank, once its share of the cores has been set here."""


def limit_blas_threads(comm: MPI.Comm) -> int:
    """Share the cores of each node among its ranks. Collective: all ranks of `comm`.

    Ranks times threads do not exceed the cores that the ranks of a node may use, as long as there is a core
    for every rank; ranks may be bound to cores of their own or share them. What the user has set in
    ``OMP_NUM_THREADS``, ``OPENBLAS_NUM_THREADS`` or ``MKL_NUM_THREADS`` stays.

    Parameters
    ----------
    comm : mpi4py.MPI.Comm

    Returns
    -------
    int
        Threads that BLAS uses on this rank.
    """
    threads = _share_of_node(comm, takes_part=True)
    if not any(os.environ.get(name) for name in _USER_SETTINGS):
        threadpoolctl.threadpool_limits(threads)
        os.environ["OMP_NUM_THREADS"] = str(threads)  # for libraries not loaded yet, and for child processes
        _shared_out.add(comm.rank)
    return blas_threads()


def threads_of_roots(comm: MPI.Comm, is_root: bool) -> int:
    """Return the threads of this rank while, on each node, the roots work alone. Collective: all ranks of `comm`.

    Parameters
    ----------
    comm : mpi4py.MPI.Comm
    is_root : bool
        Whether this rank is one that others wait for.
    """
    return _share_of_node(comm, takes_part=is_root)


def _share_of_node(comm: MPI.Comm, takes_part: bool) -> int:
    """Share out the cores of each node among those of its ranks that take part; one for any other."""
    node = comm.Split_type(MPI.COMM_TYPE_SHARED)
    threads = fair_share(node.allgather(_usable_cores() if takes_part else set()), node.rank)
    node.Free()
    return threads


@contextmanager
def more_threads(threads: int) -> Iterator[None]:
    """Use so many threads on this rank, if it was not the user who set how many there are."""
    if not _shared_out:
        yield
        return
    with _pools().limit(limits=threads):
        yield


@cache
def _pools() -> threadpoolctl.ThreadpoolController:
    """Return what sets the threads of the libraries that are loaded; to look for these takes milliseconds."""
    return threadpoolctl.ThreadpoolController()


def blas_threads() -> int:
    """Return how many threads BLAS uses on this rank."""
    pools = threadpoolctl.threadpool_info()
    return max((pool["num_threads"] for pool in pools if pool["user_api"] == "blas"), default=1)


def fair_share(cores_of_ranks: list[set[int]], rank: int) -> int:
    """Whole cores for ``rank``, one at least, where each core is divided among the ranks that may use it."""
    users = Counter(core for cores in cores_of_ranks for core in cores)
    return max(1, int(sum(Fraction(1, users[core]) for core in cores_of_ranks[rank])))


def _usable_cores() -> set[int]:
    if hasattr(os, "sched_getaffinity"):
        return os.sched_getaffinity(0)
    return set(range(os.cpu_count() or 1))  # macOS
