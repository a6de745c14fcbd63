"""The main path: simulate where asked, infer, write."""

from __future__ import annotations

from pathlib import Path

from hydrabeam_mpi.cautions import cautions_of_times
from hydrabeam_mpi.config import Job
from hydrabeam_mpi.config.named import expand, for_simulation
from hydrabeam_mpi.fit.channels import Clock, describe_channels, infer_channels
from hydrabeam_mpi.fit.joint import infer_with_effects
from hydrabeam_mpi.io.disk import check_space, write_computed, writing
from hydrabeam_mpi.io.posterior_file import ChannelRecord
from hydrabeam_mpi.io.provenance import provenance
from hydrabeam_mpi.mpi import (
    Comm,
    ProcessGrid,
    bcast_object,
    library_version,
    peak_rss_mb,
    recv_object,
    send_object,
    together,
)
from hydrabeam_mpi.result.output import (
    check_records,
    input_files,
    least_result_bytes,
    staged,
    write_conversions,
    write_job_and_provenance,
    write_result,
)
from hydrabeam_mpi.setup.problem import Problem, estimate_noise, prepare
from hydrabeam_mpi.simulation.mock import mock_observation, simulate_to
from hydrabeam_mpi.terminal.progress import say, warn


def simulate(world: Comm, job: Job, job_path: Path, out: Path, overwrite: bool, threads: int) -> None:
    """Write mock data and their truth, ``data.uvh5`` and ``truth.h5``, into ``out``.

    Collective: all ranks of `world`. Parameters and errors as of `infer`.
    """
    with staged(world, job_path, job, out, overwrite, only_simulates=True) as folder:
        simulate_to(world, job, folder)
        with together(world):
            if world.rank == 0:
                assert job.data.simulate is not None
                warn(cautions_of_times(job, mock_observation(job.data.simulate, job.data.polarization)))
                record = provenance(
                    job, [named.path for named in for_simulation(job)], world.size, threads, library_version()
                )
                with writing(folder):
                    write_job_and_provenance(folder, job, record)
    say(f"wrote {out}", world.rank == 0)


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
            records = gather_records(grid, describe_channels(grid, mine, results))
        memory = peak_rss_mb(world)
        with together(world):
            if world.rank == 0:
                about = provenance(job, input_files(job, problem), world.size, threads, library_version())
                run = {"wall_s": clock.inference, "phases_s": clock.seconds, "peak_rss_mb": memory}
                check_records(records)
                write_computed(folder, lambda place: write_result(place, job, problem, records, about, run))
                write_conversions(folder, problem.observation, records, about["versions"]["hydrabeam_mpi"])
    say(f"wrote {out}", world.rank == 0)


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


def gather_records(grid: ProcessGrid, records: list[ChannelRecord]) -> list[ChannelRecord]:
    """Bring the channels' records to rank 0, one after the other."""
    if grid.is_world_root:
        elsewhere = range(len(records), grid.n_channels)
        return records + [recv_object(grid.world, grid.root_of(channel)) for channel in elsewhere]
    for record in records:
        send_object(grid.world, record, dest=0)
    return []
