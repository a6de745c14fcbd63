"""`hydrabeam sample`: draws of beam, effects and noise together, in chains that grow."""

from __future__ import annotations

from pathlib import Path

from hydrabeam_mpi.api.sampling import run_sampling, with_sample
from hydrabeam_mpi.api.setup import Setup
from hydrabeam_mpi.api.shared import begun
from hydrabeam_mpi.config import Job
from hydrabeam_mpi.mpi import Comm
from hydrabeam_mpi.terminal.progress import say


def sample(world: Comm, job: Job, job_path: Path, out: Path, chains: int | None, draws: int | None) -> None:
    """Begin the chains of a job in a folder, or go on with them.

    Collective: all ranks of `world`.

    Parameters
    ----------
    world : Comm
    job : Job
        Where it has a ``[data.simulate]`` table, the data are simulated first.
    job_path : Path
        The file that it was read from.
    out : Path
        Folder of the chains.
    chains, draws : int, optional
        Instead of those of the job.

    Raises
    ------
    InputError
        On all ranks, if something in the job or in a file is wrong, or the folder has chains of another job.
    """
    given = {"chains": chains, "draws": draws}
    changed = with_sample(job, {name: value for name, value in given.items() if value is not None})
    setup = Setup.of(changed, world, path=job_path)
    with begun(setup) as (folder, threads):
        run_sampling(setup, out, folder, threads)
    say(f"wrote {out}", world.rank == 0)
