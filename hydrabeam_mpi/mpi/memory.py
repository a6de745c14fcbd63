"""How much memory the ranks have needed, and how much there is."""

from __future__ import annotations

import os
import resource
import sys
from collections.abc import Iterator
from pathlib import Path

from mpi4py import MPI

CGROUPS = Path("/sys/fs/cgroup")


def peak_rss_mb(comm: MPI.Comm) -> float:
    """Largest resident memory that any rank has had so far, in 1e6 bytes. Collective: all ranks of `comm`."""
    return float(comm.allreduce(_own_peak_bytes(), MPI.MAX)) / 1e6


def memory_per_rank(comm: MPI.Comm) -> int:
    """Bytes that a rank can have at most, where those on a machine share alike. Collective: all ranks of `comm`."""
    machine = comm.Split_type(MPI.COMM_TYPE_SHARED)
    share = min(_machine_bytes()) // machine.size
    machine.Free()
    own, _ = resource.getrlimit(resource.RLIMIT_AS)
    return int(comm.allreduce(share if own == resource.RLIM_INFINITY else min(share, own), MPI.MIN))


def _machine_bytes() -> Iterator[int]:
    """Yield what the machine has, and what a batch system or a container lets its processes have of it."""
    yield os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    groups = Path("/proc/self/cgroup")
    for line in groups.read_text().splitlines() if groups.exists() else ():
        _, controllers, path = line.split(":", 2)
        if controllers not in ("", "memory"):
            continue
        name = "memory.limit_in_bytes" if controllers else "memory.max"
        root = CGROUPS / controllers
        for folder in (root / path.strip("/"), *(root / path.strip("/")).parents):
            limit = folder / name
            if limit.is_file() and (text := limit.read_text().strip()) != "max":
                yield int(text)


def _own_peak_bytes() -> int:
    # getrusage also counts the program that started this process, before it became this one.
    status = Path("/proc/self/status")
    if status.exists():
        for line in status.read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit
