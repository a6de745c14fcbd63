"""`hydrabeam sample --status DIR`: how far chains are, and how they mix."""

from __future__ import annotations

from pathlib import Path

from hydrabeam_mpi.sampling.status import status_of
from hydrabeam_mpi.sampling.storage.store import ChainStore


def print_status(folder: Path) -> None:
    """Print it. By one rank; the chains may be running.

    Raises
    ------
    InputError
        If the folder has no chains.
    """
    print(status_of(ChainStore.open(folder)))
