"""`hydrabeam simulate`: mock data and their truth."""

from __future__ import annotations

from pathlib import Path

from hydrabeam_mpi.config import Job
from hydrabeam_mpi.config.named import for_simulation
from hydrabeam_mpi.io.disk import writing
from hydrabeam_mpi.io.provenance import provenance
from hydrabeam_mpi.mpi import Comm, library_version, together
from hydrabeam_mpi.result.output import staged, write_job_and_provenance
from hydrabeam_mpi.setup.cautions import cautions_of_times
from hydrabeam_mpi.simulation.mock import simulate_to
from hydrabeam_mpi.simulation.truth import write_truth
from hydrabeam_mpi.terminal.progress import warn


def simulate(world: Comm, job: Job, job_path: Path, out: Path, overwrite: bool, threads: int) -> None:
    """Write mock data and their truth into ``out``: ``data.uvh5``, ``truth.h5``, sky and beam as other programs read.

    Collective: all ranks of `world`. Parameters and errors as of `hydrabeam_mpi.commands.infer.infer`.
    """
    with staged(world, job_path, job, out, overwrite, only_simulates=True) as folder:
        scene = simulate_to(world, job, folder)
        with together(world):
            if world.rank == 0:
                warn(cautions_of_times(job, scene.observation))
                record = provenance(
                    job, [named.path for named in for_simulation(job)], world.size, threads, library_version()
                )
                with writing(folder):
                    write_truth(folder, job, scene)
                    write_job_and_provenance(folder, job, record)
