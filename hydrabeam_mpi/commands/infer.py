"""`hydrabeam infer`: the posterior beam of every channel of a job."""

from __future__ import annotations

from pathlib import Path

from hydrabeam_mpi.commands.job_run import prepare_shared
from hydrabeam_mpi.config import Job
from hydrabeam_mpi.fit.channels import infer_channels
from hydrabeam_mpi.fit.clock import Clock
from hydrabeam_mpi.fit.joint import infer_with_effects
from hydrabeam_mpi.io.disk import write_computed
from hydrabeam_mpi.io.provenance import provenance
from hydrabeam_mpi.mpi import Comm, ProcessGrid, gather_by_channel, library_version, peak_rss_mb, together
from hydrabeam_mpi.result.describe import describe_channels
from hydrabeam_mpi.result.output import (
    check_records,
    input_files,
    staged,
    write_conversions,
    write_result,
)
from hydrabeam_mpi.terminal.progress import say


def infer(world: Comm, job: Job, job_path: Path, out: Path, overwrite: bool, threads: int) -> None:
    """Write the posterior beam of every channel of a job into ``out``.

    Collective: all ranks of `world`.

    Parameters
    ----------
    world : Comm
    job : Job
        Where it has a ``[data.simulate]`` table, the data are simulated first.
    job_path : Path
        The file that it was read from.
    out : Path
        Folder that appears when all is written.
    overwrite : bool
        Whether an existing ``out`` is replaced.
    threads : int
        BLAS threads of this rank, for the record.

    Raises
    ------
    InputError
        On all ranks, if something in the job or in a file is wrong.
    """
    clock = Clock()
    with staged(world, job_path, job, out, overwrite) as folder:
        with clock.time("prepare"):
            problem = prepare_shared(world, job, folder)
        grid = ProcessGrid.split(world, problem.observation.Nfreqs)
        mine = problem.of_channels(grid.channels)
        results = infer_with_effects(grid, problem, mine, clock) if job.effects else infer_channels(grid, mine, clock)
        with clock.time("describe"):
            records = gather_by_channel(grid, describe_channels(grid, mine, results))
        memory = peak_rss_mb(world)
        with together(world):
            if world.rank == 0:
                about = provenance(job, input_files(job, problem), world.size, threads, library_version())
                run = {"wall_s": clock.inference, "phases_s": clock.seconds, "peak_rss_mb": memory}
                check_records(records)
                write_computed(folder, lambda place: write_result(place, job, problem, records, about, run))
                write_conversions(folder, problem.observation, records, about["versions"]["hydrabeam_mpi"])
    say(f"wrote {out}", world.rank == 0)
