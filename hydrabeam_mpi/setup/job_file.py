"""The job file that a command names, read before anything that takes seconds is imported."""

from __future__ import annotations

import os
from pathlib import Path

from hydrabeam_mpi.config import Job, load_job
from hydrabeam_mpi.config.named import for_inference, named_files, simulation_files
from hydrabeam_mpi.config.sizes import check_sizes
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.kept_rounds import latest_round, origin_of
from hydrabeam_mpi.io.staging import check_place
from hydrabeam_mpi.model.engines import check_engine
from hydrabeam_mpi.mpi import Comm, memory_per_rank, together


def load(
    world: Comm, path: Path, needs_simulation: bool = False, needs_holdout: bool = False, takes_several: bool = False
) -> Job:
    """Read the job on rank 0 and share it.

    Collective: all ranks of `world`.

    Raises
    ------
    InputError
        On all ranks, if the job cannot be used, or simulates nothing where it ``needs_simulation``, or holds
        nothing out where it ``needs_holdout``, or has several polarisations where it does not
        ``takes_several``.
    """
    job, memory = None, memory_per_rank(world)
    with together(world):
        if world.rank == 0:
            job = load_job(path)
            try:
                check_sizes(job, memory)
                check_engine(job.solver.engine, job.data.smearing)
                _ = takes_several or job.data.pol
            except InputError as error:
                error.locate(path)
                raise
            if needs_simulation and job.data.simulate is None:
                remedy = "add it, see jobs/paper/job.toml"
                raise InputError("is missing", file=path, field="[data.simulate]", remedy=remedy)
            if needs_holdout:
                check_holds_out(job, path)
    return world.bcast(job)


def check_holds_out(job: Job, path: Path | None = None) -> None:
    """Make sure that a job keeps data from the fit.

    Raises
    ------
    InputError
        If it does not.
    """
    if job.holdout.kind == "none":
        message = "keeps no data from the fit, and only such data can confirm what the loop finds"
        remedy = "use kind = \"times\" or another one, or 'hydrabeam infer'"
        raise InputError(message, file=path, field="[holdout] kind", remedy=remedy)


def check_paths(world: Comm, job: Job, path: Path, out: Path, overwrite: bool, only_simulates: bool = False) -> None:
    """Look at the files that a job names, and at where its result shall be.

    Collective: all ranks of `world`. What is looked at is said in `read_files` and `unread_files`.

    Raises
    ------
    InputError
        On all ranks, if a file is missing or not what it should be, or something stands where the result shall be.
    """
    with together(world):
        if world.rank == 0:
            kept = (*read_files(job, only_simulates), *unread_files(job, path))
            check_place(out, overwrite, kept)


def may_go_on(job: Job, out: Path) -> bool:
    """Tell whether there is the result of a loop of this job that was interrupted, so that it may be replaced."""
    kept = latest_round(Path(os.path.realpath(out)))
    return kept is not None and origin_of(kept).get("job") == job.model_dump(mode="json", exclude_none=True)


def read_files(job: Job, only_simulates: bool = False) -> list[Path]:
    """List what a command reads besides the job file, or else say in an `InputError` which file cannot be read."""
    return simulation_files(job) if only_simulates else named_files(job)


def unread_files(job: Job, path: Path) -> list[Path]:
    """List what a job names and its run may yet leave unread, and the job file ``path``: they must not be lost."""
    return [path, *(named.path for named in for_inference(job))]
