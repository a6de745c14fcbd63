"""`hydrabeam sample`: draws of beam, effects and noise together, in chains that grow."""

from __future__ import annotations

from functools import cache, partial
from pathlib import Path

from hydrabeam_mpi.api.sampling import run_sampling, with_sample
from hydrabeam_mpi.api.setup import Setup
from hydrabeam_mpi.api.shared import begun
from hydrabeam_mpi.config import Job
from hydrabeam_mpi.mpi import Comm
from hydrabeam_mpi.sampling.storage.store import ChainStore
from hydrabeam_mpi.terminal.interrupt import leaving
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
    # Whichever thread leaves after a signal; see `leaving`.
    tell = cache(partial(_tell_kept, world, out))
    try:
        with leaving(tell), begun(setup) as (folder, threads):
            run_sampling(setup, out, folder, threads)
    except KeyboardInterrupt:
        tell()
        raise
    say(f"wrote {out}", world.rank == 0)


def _tell_kept(world: Comm, out: Path) -> None:
    """Say how many draws there are after an interrupted run."""
    if world.rank == 0 and ChainStore.exists(out):
        store = ChainStore.open(out)
        done = ", ".join(str(store.n_draws(chain)) for chain in range(store.chains))
        say(f"kept in {out}: chains of {done} draws, from where the same command goes on")
