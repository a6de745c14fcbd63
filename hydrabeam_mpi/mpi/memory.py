"""How much memory the ranks have needed, and how much each can have."""

from __future__ import annotations

import resource

from mpi4py import MPI

from hydrabeam_mpi.memory import machine_bytes, own_peak_bytes


def peak_rss_mb(comm: MPI.Comm) -> float:
    """Largest resident memory that any rank has had so far, in 1e6 bytes. Collective: all ranks of `comm`."""
    return float(comm.allreduce(own_peak_bytes(), MPI.MAX)) / 1e6


def memory_per_rank(comm: MPI.Comm) -> int:
    """Bytes that a rank can have at most, where those on a machine share alike. Collective: all ranks of `comm`."""
    machine = comm.Split_type(MPI.COMM_TYPE_SHARED)
    share = machine_bytes() // machine.size
    machine.Free()
    own, _ = resource.getrlimit(resource.RLIMIT_AS)
    return int(comm.allreduce(share if own == resource.RLIM_INFINITY else min(share, own), MPI.MIN))
