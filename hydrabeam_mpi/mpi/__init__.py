"""Processes: which rank has which channels, how arrays are sent between ranks, and how a failure ends all ranks."""

from hydrabeam_mpi.errors import InputError

try:
    from mpi4py.MPI import COMM_WORLD, Comm
except (ImportError, RuntimeError) as error:
    raise InputError(
        f"mpi4py finds no MPI ({str(error).partition(chr(10))[0]})",
        remedy="pip install 'hydrabeam_mpi[mpi]', or on a cluster load the MPI that mpi4py was installed with",
    ) from error

from hydrabeam_mpi.mpi.abort import INTERRUPTED_STATUS, end_interrupted, install_abort_hook, refuse
from hydrabeam_mpi.mpi.apart import FailedElsewhere, apart
from hydrabeam_mpi.mpi.by_channel import by_channel, gather_by_channel, roots_of, share_by_channel
from hydrabeam_mpi.mpi.collectives import (
    allreduce_max,
    allreduce_sum,
    allreduce_sum_triangle,
    bcast_array,
    bcast_object,
    gather_items,
    gather_objects,
    recv_object,
    scatter_objects,
    send_object,
)
from hydrabeam_mpi.mpi.failure import together
from hydrabeam_mpi.mpi.grid import ProcessGrid, alone
from hydrabeam_mpi.mpi.launcher import check_one_world
from hydrabeam_mpi.mpi.library import library_version
from hydrabeam_mpi.mpi.memory import memory_per_rank, peak_rss_mb
from hydrabeam_mpi.mpi.threads import blas_threads, limit_blas_threads
from hydrabeam_mpi.mpi.window import OneSided, free_windows

__all__ = [
    "COMM_WORLD",
    "INTERRUPTED_STATUS",
    "Comm",
    "FailedElsewhere",
    "OneSided",
    "ProcessGrid",
    "allreduce_max",
    "allreduce_sum",
    "allreduce_sum_triangle",
    "alone",
    "apart",
    "bcast_array",
    "bcast_object",
    "blas_threads",
    "by_channel",
    "check_one_world",
    "end_interrupted",
    "free_windows",
    "gather_by_channel",
    "gather_items",
    "gather_objects",
    "install_abort_hook",
    "library_version",
    "limit_blas_threads",
    "memory_per_rank",
    "peak_rss_mb",
    "recv_object",
    "refuse",
    "roots_of",
    "scatter_objects",
    "send_object",
    "share_by_channel",
    "together",
]
