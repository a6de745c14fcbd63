"""`hydrabeam correct`: data without the effects of the instrument that a result found."""

from __future__ import annotations

from pathlib import Path

from hydrabeam_mpi.api.applied import load_shared, setup_for
from hydrabeam_mpi.api.correction import run_correction
from hydrabeam_mpi.api.setup import Setup
from hydrabeam_mpi.mpi import Comm, together
from hydrabeam_mpi.result.output import staged
from hydrabeam_mpi.setup.job_file import check_paths, load


def correct(world: Comm, source: Path, job_path: Path | None, out: Path, overwrite: bool, threads: int) -> None:
    """Take the effects of a result out of data, its own where no other job is named, and write them into ``out``.

    Antennas that the loop left out of its own data are flagged. Collective: all ranks of `world`. Other parameters and
    errors as of `hydrabeam_mpi.commands.predict.predict`.
    """
    result = load_shared(world, source)
    bad: frozenset[int] = frozenset()
    if job_path is None:
        amended = world.bcast((source / "amended.toml").exists())
        job_path = source / ("amended.toml" if amended else "job.toml")
        job = load(world, job_path)
        before = result.job.data.exclude_antennas
        bad = frozenset(job.data.exclude_antennas) - frozenset(before)
        job = job.model_copy(update={"data": job.data.model_copy(update={"exclude_antennas": before})})
    else:
        job = load(world, job_path)
    setup = setup_for(result, Setup.of(job, world, path=job_path))
    check_paths(world, setup.job, job_path, out, overwrite)
    with staged(world, job_path, setup.job, out, overwrite, more=result.files) as folder:
        correction = run_correction(result, setup, folder, threads, bad, folder)
        with together(world):
            if world.rank == 0:
                correction.fill(folder)
