"""What all runs share: where they begin, and the result on rank 0."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from hydrabeam_mpi.api.result import Result
from hydrabeam_mpi.api.setup import Setup
from hydrabeam_mpi.config import Job
from hydrabeam_mpi.config.sizes import check_sizes
from hydrabeam_mpi.fit.carried_over import CarriedOver
from hydrabeam_mpi.fit.channels import ChannelResult
from hydrabeam_mpi.fit.prior_widths import as_stated
from hydrabeam_mpi.fit.state import Values
from hydrabeam_mpi.io.posterior_file import ChannelRecord, PosteriorFile
from hydrabeam_mpi.io.provenance import provenance
from hydrabeam_mpi.io.stored import store
from hydrabeam_mpi.loop.selection.heldout_numbers import HeldoutNumbers
from hydrabeam_mpi.mpi import (
    ProcessGrid,
    blas_threads,
    by_channel,
    free_windows,
    library_version,
    limit_blas_threads,
    memory_per_rank,
    together,
)
from hydrabeam_mpi.result.describe import describe_channels
from hydrabeam_mpi.result.observed import observed
from hydrabeam_mpi.result.output import check_records, input_files, summarise
from hydrabeam_mpi.result.over_frequency import warnings_over_frequency
from hydrabeam_mpi.result.summary import GRID_AZ, GRID_ZA
from hydrabeam_mpi.setup.problem import Problem


@contextmanager
def begun(setup: Setup) -> Iterator[tuple[Path | None, int]]:
    """Give a folder for simulated data that vanishes afterwards, and how many threads BLAS has on this rank.

    The folder is None where there is nothing to simulate. On several nodes TMPDIR must name one that all of them see.
    Several ranks share out the cores, as the commands do. Collective: all ranks of the setup.

    Raises
    ------
    InputError
        On all ranks, if the job cannot fit into memory. What is wrong is told by the name of file or argument.
    """
    world = setup.comm
    with setup.telling():
        memory = memory_per_rank(world)
        with together(world):
            check_sizes(setup.job, memory)
        threads = limit_blas_threads(world) if world.size > 1 else blas_threads()
        if setup.job.data.simulate is None:
            yield None, threads
            free_windows(world)
            return
        made = TemporaryDirectory(prefix="hydrabeam-") if world.rank == 0 else None
        try:
            yield world.bcast(Path(made.name) if made else None), threads
            world.Barrier()
        finally:
            if made:
                made.cleanup()


def origin_of(setup: Setup, problem: Problem, threads: int) -> dict[str, Any]:
    """Return where a result comes from."""
    inputs = input_files(setup.job, problem, setup.given.fields)
    about = provenance(setup.job, inputs, setup.comm.size, threads, library_version())
    return about if problem.earlier is None else {**about, "sha256_before": problem.earlier.made_from}


def prior_told(job: Job, carried: CarriedOver | None, values: Values, asked: bool) -> dict[str, Any]:
    """Return what a summary says of effects of the result that is the prior, and of widths that were adapted.

    The ``job`` says whether beams may differ from their models as a whole, ``asked`` whether the data were for widths.
    """
    told: dict[str, Any] = {"widths_asked": asked}
    if carried:
        told["prior"] = {"result": str(job.prior.file), **carried.summary}
    if values.prior_widths is not None:
        told["prior_adapted"] = as_stated(values.prior_widths) | {"shape": job.prior.has_shape}
    return told


def over_frequency_told(results: Sequence[ChannelResult]) -> dict[str, Any]:
    """Return what a summary says of channels that hang together."""
    coupled = results[0].coupled
    return {"over_frequency": coupled.summary} if coupled else {}


def gather_records(
    grid: ProcessGrid,
    problem: Problem,
    results: list[ChannelResult],
    numbers: HeldoutNumbers | None,
    waiting: Path | None = None,
) -> list[ChannelRecord]:
    """Return what is written of all channels, on rank 0; empty on other ranks. Collective: all ranks of the grid.

    Parameters
    ----------
    grid : ProcessGrid
    problem : Problem
        Of all channels.
    results : list of ChannelResult
        Of the rank group's channels.
    numbers : HeldoutNumbers, optional
        In which effects are part of the model: those that the loop judges by, of data as they were read.
    waiting : Path, optional
        Folder in which covariances wait to be written, so that rank 0 never holds all of them.
    """
    mine, records = describe_channels(grid, problem.of_channels(grid.channels), results), []
    for channel, record in enumerate(by_channel(grid, mine)):
        for name in {"covariance", "information"} & record.arrays.keys():
            store(waiting, record.arrays, name, channel)
        records.append(record)
    if numbers is None:
        return records
    return [replace(one, summary={**one.summary, **numbers.summary(f)}) for f, one in enumerate(records)]


def make_result(
    setup: Setup,
    problem: Problem,
    records: list[ChannelRecord],
    integrations: Sequence[str],
    about: dict[str, Any],
    run: dict[str, Any],
    warnings: Sequence[str] = (),
    effects: dict[str, Any] | None = None,
) -> Result:
    """Put together what rank 0 has of a run.

    Parameters
    ----------
    setup : Setup
    problem : Problem
        Of all channels.
    records : list of ChannelRecord
    integrations : sequence of str
        Checksums of the data; see `integrations_of`.
    about, run : dict
        Where it comes from, and what is told of the run itself.
    warnings : sequence of str
        First in the summary.
    effects : dict, optional
        Those of the model; see `effects_found`.

    Raises
    ------
    InputError
        If not all numbers are finite.
    """
    check_records(records)
    before = problem.earlier.integrations if problem.earlier else ()
    about = {**about, "integrations": [*before, *integrations]}
    coupled, telescope = run.get("over_frequency"), problem.observation.telescope_name
    warnings = [*(warnings_over_frequency(coupled) if coupled else ()), *warnings]
    basis, pol, seen = problem.basis.describe(), problem.observation.pols[0], observed(problem)
    content = PosteriorFile(basis, about, pol, GRID_ZA, GRID_AZ, records, telescope, effects, coupled, seen)
    return Result(setup.job, content, summarise(setup.job, problem, content, run, warnings))
