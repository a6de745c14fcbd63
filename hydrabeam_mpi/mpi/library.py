"""Which MPI this is."""

from __future__ import annotations

from mpi4py import MPI


def library_version() -> str:
    """Return the first line of what the MPI library says of itself."""
    return MPI.Get_library_version().splitlines()[0].strip()
