"""Where a result comes from: the resolved job, versions of what computed it, checksums of what it read."""

from __future__ import annotations

import platform
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from hydrabeam_mpi.config import Job
from hydrabeam_mpi.io.checksums import checksum
from hydrabeam_mpi.version import __version__

PACKAGES = ("numpy", "scipy", "h5py", "astropy", "pyuvdata", "pyradiosky", "mpi4py", "finufft")


def provenance(job: Job, inputs: Iterable[Path], ranks: int, threads: int, mpi: str) -> dict[str, Any]:
    """Collect what every output carries.

    Parameters
    ----------
    job : Job
        The resolved job, with its seed.
    inputs : iterable of Path
        Files (or measurement set folders) that were read.
    ranks, threads : int
        MPI ranks and BLAS threads a rank.
    mpi : str
        Version line of the MPI library.
    """
    versions = {"hydrabeam_mpi": __version__, "python": platform.python_version(), "mpi": mpi}
    for package in PACKAGES:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:  # pragma: no cover - an optional package that is not there
            versions[package] = "not installed"
    return {
        "job": job.model_dump(mode="json", exclude_none=True),
        "versions": versions,
        "ranks": ranks,
        "threads_per_rank": threads,
        "sha256": {str(path): _checksum_of_input(path) for path in inputs},
    }


def _checksum_of_input(path: Path) -> str:
    """Return the checksum of what was read, or say that it is gone."""
    try:
        return checksum(path)
    except OSError as error:
        return f"not known: cannot be read at the end of the run ({error.strerror})"
