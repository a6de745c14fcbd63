"""The job file that a command names, read before anything that takes seconds is imported."""

from __future__ import annotations

from pathlib import Path

from hydrabeam_mpi.config import Job, load_job
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.mpi import Comm, together


def load(world: Comm, path: Path, needs_simulation: bool = False, needs_holdout: bool = False) -> Job:
    """Read the job on rank 0 and share it.

    Collective: all ranks of `world`.

    Raises
    ------
    InputError
        On all ranks, if the job cannot be used, or simulates nothing where it ``needs_simulation``, or holds
        nothing out where it ``needs_holdout``.
    """
    job = None
    with together(world):
        if world.rank == 0:
            job = load_job(path)
            if needs_simulation and job.data.simulate is None:
                remedy = "add it, see jobs/paper/job.toml"
                raise InputError("is missing", file=path, field="[data.simulate]", remedy=remedy)
            if needs_holdout and job.holdout.kind == "none":
                message = "keeps no data from the fit, and only such data can confirm what the loop finds"
                remedy = "use kind = \"times\" or another one, or 'hydrabeam infer'"
                raise InputError(message, file=path, field="[holdout] kind", remedy=remedy)
    return world.bcast(job)
