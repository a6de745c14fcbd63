"""`hydrabeam predict`: how near a result comes to other data, without fitting."""

from __future__ import annotations

from pathlib import Path

from hydrabeam_mpi.api.applied import load_shared, setup_for
from hydrabeam_mpi.api.prediction import run_prediction
from hydrabeam_mpi.api.setup import Setup
from hydrabeam_mpi.mpi import Comm, together
from hydrabeam_mpi.result.output import staged
from hydrabeam_mpi.setup.job_file import check_paths, load


def predict(world: Comm, source: Path, job_path: Path, out: Path, overwrite: bool, threads: int) -> None:
    """Predict the data of a job with a result, and write how near that comes into ``out``.

    Collective: all ranks of `world`.

    Parameters
    ----------
    world : Comm
    source : Path
        The result's folder.
    job_path : Path
        The job file of the data.
    out : Path
        Folder that appears when all is written.
    overwrite : bool
        Whether an existing ``out`` is replaced.
    threads : int
        BLAS threads of this rank, for the record.

    Raises
    ------
    InputError
        On all ranks, if something in the result, the job or a file is wrong.
    """
    result = load_shared(world, source)
    setup = setup_for(result, Setup.of(load(world, job_path), world, path=job_path))
    check_paths(world, setup.job, job_path, out, overwrite)
    with staged(world, job_path, setup.job, out, overwrite, more=result.files) as folder:
        prediction = run_prediction(result, setup, folder, threads)
        with together(world):
            if world.rank == 0:
                prediction.fill(folder)
