"""How much memory the ranks have needed."""

from __future__ import annotations

import resource
import sys
from pathlib import Path

from mpi4py import MPI


def peak_rss_mb(comm: MPI.Comm) -> float:
    """Largest resident memory that any rank has had so far, in 1e6 bytes. Collective: all ranks of `comm`."""
    return float(comm.allreduce(_own_peak_bytes(), MPI.MAX)) / 1e6


def _own_peak_bytes() -> int:
    # getrusage also counts the program that started this process, before it became this one.
    status = Path("/proc/self/status")
    if status.exists():
        for line in status.read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit
