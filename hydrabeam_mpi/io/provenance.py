"""Where a result comes from: the resolved job, versions of what computed it, checksums of what it read."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from hydrabeam_mpi import __version__
from hydrabeam_mpi.config import Job

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
        "sha256": {str(path): checksum(path) for path in inputs},
    }


def checksum(path: Path) -> str:
    """Return the SHA-256 of a file, or of all files of a folder in order of name."""
    digest = hashlib.sha256()
    for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
        if file.is_file():
            with file.open("rb") as stream:
                while block := stream.read(1 << 22):
                    digest.update(block)
    return digest.hexdigest()
