"""`hydrabeam infer`: the posterior beam of every channel of a job."""

from __future__ import annotations

from pathlib import Path

from hydrabeam_mpi.api.inference import run_inference
from hydrabeam_mpi.api.setup import Setup
from hydrabeam_mpi.config import Job
from hydrabeam_mpi.mpi import Comm, together
from hydrabeam_mpi.result.output import staged
from hydrabeam_mpi.result.told import say_result
from hydrabeam_mpi.terminal.progress import say, warn


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
    with staged(world, job_path, job, out, overwrite) as folder:
        result = run_inference(Setup.of(job, world, path=job_path), folder, threads, waiting=folder)
        with together(world):
            if world.rank == 0:
                result.fill(folder)
                for pol in result.polarizations:
                    of_several = f"{pol}, " if len(result.polarizations) > 1 else ""
                    for line in say_result(result[pol].summary):
                        say(of_several + line)
                warn(result.summary["warnings"])
