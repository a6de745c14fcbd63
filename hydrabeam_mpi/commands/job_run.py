"""What the commands share of a run: the problem on every rank."""

from __future__ import annotations

from pathlib import Path

from hydrabeam_mpi.config import Job
from hydrabeam_mpi.config.named import expand
from hydrabeam_mpi.io.disk import check_space
from hydrabeam_mpi.mpi import (
    Comm,
    bcast_object,
    together,
)
from hydrabeam_mpi.result.output import (
    least_result_bytes,
)
from hydrabeam_mpi.setup.problem import Problem, estimate_noise, prepare
from hydrabeam_mpi.simulation.mock import simulate_to
from hydrabeam_mpi.terminal.progress import say, warn


def prepare_shared(world: Comm, job: Job, folder: Path) -> Problem:
    """Simulate where asked, and set up the problem on every rank.

    Collective: all ranks of `world`.

    Raises
    ------
    InputError
        On all ranks, if something in the job or in a file is wrong, or ``folder`` has no room for the result.
    """
    with together(world):
        if world.rank == 0:
            check_space(folder, least_result_bytes(job))
    truths = simulate_to(world, job, folder) if job.data.simulate else ()
    problem = None
    with together(world):
        if world.rank == 0:
            say("reading metadata, sky and beam")
            files = (folder / "data.uvh5",) if job.data.simulate else expand(job.data.files, "[data] files")
            problem = prepare(job, files, truths)
            check_space(folder, least_result_bytes(job, problem.observation.Nfreqs))
            say(_one_line(problem))
            warn(problem.cautions)
    problem = bcast_object(world, problem)
    return estimate_noise(world, problem)


def _one_line(problem: Problem) -> str:
    """Say what is inferred from what."""
    observation, basis = problem.observation, problem.basis
    return (
        f"{basis.n_modes} {'complex' if basis.is_complex else 'real'} coefficients in {observation.Nfreqs} channel(s)"
        f" from {len(problem.train.times)} times x {len(problem.train.bls)} baselines"
        f" ({problem.n_unique_baselines} unique), {problem.sky.Nsrc} sources"
    )
