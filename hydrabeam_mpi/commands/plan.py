"""`hydrabeam plan`: what a job will take, before it is queued."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from pathlib import Path

from hydrabeam_mpi.api.plan import plan
from hydrabeam_mpi.api.setup import Setup
from hydrabeam_mpi.config import Job
from hydrabeam_mpi.mpi import Comm


def print_plan(
    world: Comm,
    job: Job,
    job_path: Path,
    ranks: Sequence[int],
    commands: Sequence[str] | None,
    found: int,
    as_json: bool,
) -> None:
    """Print what commands of a job will take on numbers of ranks.

    Collective: all ranks of `world`.

    Parameters
    ----------
    world : Comm
        Between these ranks messages are timed.
    job : Job
    job_path : Path
        The file that it was read from.
    ranks : sequence of int
    commands : sequence of str, optional
        Those that the job can do by default.
    found : int
        Effects that a loop is taken to find.
    as_json : bool
        Whether to print JSON.

    Raises
    ------
    InputError
        On all ranks, if something in the job or in a file is wrong.
    """
    # What this process has done so far is what any command does first.
    startup_s = time.process_time()
    made = plan(Setup.of(job, world, path=job_path), ranks, commands, found, startup_s=startup_s)
    if world.rank == 0:
        print(json.dumps(made.as_table(), indent=2) if as_json else made, end="\n" if as_json else "")
