"""The main path: simulate where asked, infer, write."""

from __future__ import annotations

import json
import pickle
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from hydrabeam_mpi.config import Job, named_files
from hydrabeam_mpi.diagnose import GRID_AZ, GRID_ZA, warnings_of
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.inference import Clock, describe_channels, infer_channels
from hydrabeam_mpi.io.beamfits import write_power_beam
from hydrabeam_mpi.io.posterior_file import ChannelRecord, PosteriorFile, write_posterior
from hydrabeam_mpi.io.provenance import provenance
from hydrabeam_mpi.io.staging import StagedDirectory, writing
from hydrabeam_mpi.loop.joint import infer_with_effects
from hydrabeam_mpi.mpi import (
    Comm,
    ProcessGrid,
    bcast_object,
    library_version,
    peak_rss_mb,
    recv_array,
    send_array,
    together,
)
from hydrabeam_mpi.problem import Problem, estimate_noise, expand, prepare
from hydrabeam_mpi.progress import say, warn
from hydrabeam_mpi.simulate import mock_observation, simulate_to
from hydrabeam_mpi.skies import cautions_of_positions


def simulate(world: Comm, job: Job, job_path: Path, out: Path, overwrite: bool, threads: int) -> None:
    """Write mock data and their truth, ``data.uvh5`` and ``truth.h5``, into ``out``.

    Collective: all ranks of `world`. Parameters and errors as of `infer`.
    """
    with staged(world, job_path, job, out, overwrite) as folder:
        simulate_to(world, job, folder)
        with together(world):
            if world.rank == 0:
                assert job.data.simulate is not None
                warn(cautions_of_positions(job, mock_observation(job.data.simulate, job.data.polarization)))
                record = provenance(job, [], world.size, threads, library_version())
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
                inputs = [path for path in input_files(job, problem) if path.parent != folder]
                about = provenance(job, inputs, world.size, threads, library_version())
                run = {"wall_s": clock.inference, "phases_s": clock.seconds, "peak_rss_mb": memory}
                with writing(folder):
                    write_result(folder, job, problem, records, about, run)
    say(f"wrote {out}", world.rank == 0)


@contextmanager
def staged(world: Comm, job_path: Path, job: Job, out: Path, overwrite: bool) -> Iterator[Path]:
    """Give a folder to write into that becomes ``out`` when all went well, and vanishes otherwise.

    Collective: all ranks of `world`. An `InputError` that names no file is about a key of the job file.
    """
    folder = None
    with together(world):
        if world.rank == 0:
            folder = StagedDirectory(out, overwrite, named_files(job))
    folder = world.bcast(folder)
    try:
        yield folder.partial
    except BaseException as error:
        # By every rank: one that fails alone ends the others before they could.
        folder.discard()
        if isinstance(error, InputError):
            error.locate(job_path)
        raise
    with together(world):
        if world.rank == 0:
            folder.publish()


def prepare_shared(world: Comm, job: Job, folder: Path) -> Problem:
    """Simulate where asked, and set up the problem on every rank."""
    truths = simulate_to(world, job, folder) if job.data.simulate else ()
    problem = None
    with together(world):
        if world.rank == 0:
            say("reading metadata, sky and beam")
            files = (folder / "data.uvh5",) if job.data.simulate else expand(job.data.files, "[data] files")
            problem = prepare(job, files, truths)
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
    """Bring the channels' records to rank 0, arrays in messages of bounded size."""
    if grid.is_world_root:
        elsewhere = range(len(records), grid.n_channels)
        arrived = [pickle.loads(recv_array(grid.world, grid.root_of(channel)).data) for channel in elsewhere]
        return records + arrived
    for record in records:
        send_array(grid.world, np.frombuffer(pickle.dumps(record), np.uint8), dest=0)
    return []


def input_files(job: Job, problem: Problem) -> list[Path]:
    """List the files that the result depends on."""
    named = [job.noise.file, job.sky.file, job.prior.file]
    if Path(job.beam.source).is_file():
        named.append(Path(job.beam.source))
    return [*problem.files, *problem.gain_files, *(path for path in named if path is not None)]


def write_result(
    folder: Path,
    job: Job,
    problem: Problem,
    records: list[ChannelRecord],
    about: dict[str, Any],
    run: dict[str, Any],
    warnings: Sequence[str] = (),
) -> None:
    """Write the posterior, the MAP beam, the summary with further ``warnings`` first, and the provenance."""
    observation = problem.observation
    content = PosteriorFile(problem.basis.describe(), about, observation.pols[0], GRID_ZA, GRID_AZ, records)
    write_posterior(folder / "posterior.h5", content)
    maps = np.array([[record.arrays["map_mean"] for record in records]])
    history = f"Maximum a posteriori beam inferred by hydrabeam_mpi {about['versions']['hydrabeam_mpi']}."
    write_power_beam(
        folder / "beam.beamfits",
        maps,
        observation.freqs,
        [observation.pols[0]],
        telescope_name=observation.telescope_name,
        history=history,
    )
    common = {
        "flux_removed": problem.flux_removed,
        "ranks": about["ranks"],
        "threads_per_rank": about["threads_per_rank"],
        **run,
    }
    channels = [record.summary for record in records]
    summary = {
        "name": job.name,
        **channels[0],
        **common,
        "channels": channels,
        "warnings": [*warnings, *problem.cautions, *warnings_of(channels)],
    }
    (folder / "summary.json").write_text(json.dumps(summary, indent=2) + "\n")
    write_job_and_provenance(folder, job, about)


def write_job_and_provenance(folder: Path, job: Job, about: dict[str, Any]) -> None:
    """Write the resolved job and where the result comes from."""
    (folder / "job.toml").write_text(tomli_w.dumps(job.model_dump(mode="json", exclude_none=True)))
    (folder / "provenance.json").write_text(json.dumps(about, indent=2) + "\n")
