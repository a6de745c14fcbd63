"""`hydrabeam loop`: infer, trace the residual to effects, add them, and write all of it."""

from __future__ import annotations

from pathlib import Path

from hydrabeam_mpi.api.loop import run_loop
from hydrabeam_mpi.api.setup import Setup
from hydrabeam_mpi.config import Job
from hydrabeam_mpi.loop.output.resume import find_earlier
from hydrabeam_mpi.mpi import Comm, together
from hydrabeam_mpi.result.output import staged
from hydrabeam_mpi.setup.job_file import may_go_on
from hydrabeam_mpi.terminal.progress import say, warn


def close_loop(world: Comm, job: Job, job_path: Path, out: Path, overwrite: bool, threads: int) -> None:
    """Trace the residual of a job and write the amended model into ``out``.

    Collective: all ranks of `world`. Parameters and errors as of `hydrabeam_mpi.commands.infer.infer`.
    """
    earlier, replaces = None, overwrite
    with together(world):
        if world.rank == 0:
            earlier, replaces = find_earlier(job, out), overwrite or may_go_on(job, out)
    with staged(world, job_path, job, out, replaces) as folder:
        setup = Setup.of(job, world, path=job_path)
        found = run_loop(setup, folder, threads, out, earlier, overwrite=overwrite)
        with together(world):
            if world.rank == 0:
                found.fill(folder)
                said = found.record["said"]
                for line in said:
                    say(line)
                warn([one for one in found.record["warnings"] if one not in said])
