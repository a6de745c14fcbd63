"""Which MPI this is."""

from __future__ import annotations

from mpi4py import MPI


def library_version() -> str:
    """Return the first line of what the MPI library says of itself."""
    # Some libraries count the zero that ends a string in C.
    return MPI.Get_library_version().splitlines()[0].strip("\0 ")
