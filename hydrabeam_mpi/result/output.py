"""What a run leaves: a folder that appears when all is well, the result first in it, conversions of it after."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from hydrabeam_mpi.config import Job
from hydrabeam_mpi.config.named import for_inference, for_simulation
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.beamfits import write_power_beam
from hydrabeam_mpi.io.disk import replacing
from hydrabeam_mpi.io.finite import INFERENCE, MODEL, SIMULATION, check_finite
from hydrabeam_mpi.io.kept_rounds import drop_rounds, latest_round
from hydrabeam_mpi.io.posterior_file import ChannelRecord, PosteriorFile, least_bytes, write_posterior
from hydrabeam_mpi.io.staging import StagedDirectory
from hydrabeam_mpi.io.uvsource import files_among
from hydrabeam_mpi.mpi import Comm, together
from hydrabeam_mpi.result.told import warnings_of
from hydrabeam_mpi.setup.cautions import cautions_of_flags
from hydrabeam_mpi.setup.job_file import read_files, unread_files
from hydrabeam_mpi.setup.problem import Problem
from hydrabeam_mpi.terminal.interrupt import leaving, unbroken
from hydrabeam_mpi.terminal.progress import say, warn


@contextmanager
def staged(
    world: Comm,
    job_path: Path,
    job: Job,
    out: Path,
    overwrite: bool,
    only_simulates: bool = False,
    more: Sequence[Path] = (),
) -> Iterator[Path]:
    """Give a folder to write into that becomes ``out`` when all went well, which is said, and vanishes otherwise.

    Rounds of a loop that have ended stay; see `StagedDirectory.leave`. Files of ``more`` are read besides those that
    the job names. Collective: all ranks of `world`. An `InputError` that names no file is about a key of the job file.
    """
    held: list[StagedDirectory] = []

    def leave() -> None:
        for folder in held:
            folder.leave(interrupted=True)

    # Whichever thread leaves: the other one finds nothing more to do.
    with leaving(leave):
        try:
            with together(world):
                if world.rank == 0:
                    kept = unread_files(job, job_path)
                    # A signal that comes as the folder appears waits until it is known that there is one to leave.
                    with unbroken():
                        held.append(StagedDirectory(out, overwrite, [*read_files(job, only_simulates), *more], kept))
            others = world.bcast(held[0] if held else None)
            held[:] = held or [others]  # rank 0 keeps its own, which holds the lock
            yield held[0].partial
        except BaseException as error:
            _discard(world, held, error)
            if isinstance(error, InputError):
                error.locate(job_path)
            raise
    with together(world):
        if world.rank == 0:
            with unbroken():
                drop_rounds(held[0].partial)
                held[0].publish()
    say(f"wrote {out}", world.rank == 0)


def _discard(world: Comm, held: Sequence[StagedDirectory], error: BaseException) -> None:
    """Remove the folder of a run that has failed, if there is one yet."""
    for folder in held:
        if world.rank == 0:
            with unbroken():
                folder.leave(isinstance(error, KeyboardInterrupt))
        elif latest_round(folder.partial) is None:
            # By every rank: one that fails alone ends the others before they could.
            folder.discard()


def input_files(job: Job, problem: Problem, in_memory: frozenset[str] = frozenset()) -> list[Path]:
    """List the files that the result depends on, but for those that were simulated for it.

    Parameters
    ----------
    job : Job
    problem : Problem
    in_memory : frozenset of str
        Keys of the job that name no file, as what they stand for is in memory.
    """
    data = () if job.data.simulate else files_among(problem.files)
    # Not looked at again: one that has gone meanwhile is told when the result is published.
    named = (*for_simulation(job, in_memory), *for_inference(job, in_memory))
    return [*data, *problem.gain_files, *(one.path for one in named)]


def least_result_bytes(job: Job, n_channels: int | None = None) -> int:
    """Return how many bytes the result of a job has at least, for as many channels as the job tells of by default."""
    if n_channels is None:
        chosen = job.data.simulate.freqs if job.data.simulate else job.data.freqs or job.data.channels
        n_channels = len(chosen) if chosen else 1
    basis = job.basis
    if basis.kind == "zernike":
        n_modes, is_complex = (basis.max_degree + 1) * (basis.max_degree + 2) // 2, False
    else:
        n_modes, is_complex = basis.n_modes, basis.form == "complex"
    itemsize, n_matrices = np.dtype(complex if is_complex else float).itemsize, 1 + job.prior.frequency.couples
    one = least_bytes(n_channels, n_modes, itemsize, job.output.draws, n_matrices)
    return one * len(job.data.polarization)


def check_records(records: Sequence[ChannelRecord]) -> None:
    """Make sure that all numbers of all channels are finite, before any of them is written.

    Raises
    ------
    InputError
        If one is not; names the channel and what it is.
    """
    for number, record in enumerate(records):
        where = f"channel {number} ({record.freq / 1e6:.10g} MHz)"
        arrays = dict(record.arrays)
        width = arrays["prior_std"]
        arrays["prior_std"] = width[~np.isposinf(width)]  # which is that of a flat prior
        check_finite(where, {"map_model": arrays.pop("map_model")}, MODEL)
        if "map_truth" in arrays:
            check_finite(where, {"map_truth": arrays.pop("map_truth")}, SIMULATION)
        check_finite(where, {**arrays, "log_evidence": record.log_evidence, **record.summary}, INFERENCE)


def summarise(
    job: Job, problem: Problem, content: PosteriorFile, run: dict[str, Any], warnings: Sequence[str] = ()
) -> dict[str, Any]:
    """Return what ``summary.json`` says.

    Parameters
    ----------
    job : Job
    problem : Problem
        Of all channels.
    content : PosteriorFile
    run : dict
        What is told of the run itself.
    warnings : sequence of str
        Further ones, first.
    """
    about = content.provenance
    common = {
        "flux_removed": problem.flux_removed,
        "ranks": about["ranks"],
        "threads_per_rank": about["threads_per_rank"],
        **run,
    }
    channels = [record.summary for record in content.channels]
    of_result = warnings_of(channels, by_evidence=run.get("widths_asked", False))
    flagged = cautions_of_flags(channels, holds_out=job.holdout.kind != "none")
    warn(flagged)
    return {
        "name": job.name,
        **channels[0],
        **common,
        "channels": channels,
        "warnings": list(dict.fromkeys([*warnings, *problem.cautions, *flagged, *of_result])),
    }


def write_result(folder: Path, job: Job, content: PosteriorFile, summary: dict[str, Any]) -> None:
    """Write what has been computed: posterior, summary, job and provenance."""
    write_posterior(folder / "posterior.h5", content)
    write_json(folder / "summary.json", summary)
    write_job_and_provenance(folder, job, content.provenance)


def write_job_and_provenance(folder: Path, job: Job, about: dict[str, Any]) -> None:
    """Write the resolved job and where the result comes from."""
    (folder / "job.toml").write_text(tomli_w.dumps(job.model_dump(mode="json", exclude_none=True)))
    write_json(folder / "provenance.json", about)


def write_conversions(folder: Path, content: PosteriorFile) -> None:
    """Write the MAP beam in another format; what stands in its way is one more warning of the summary."""
    write_beams(folder, [content])


def write_beams(folder: Path, contents: Sequence[PosteriorFile]) -> None:
    """Do as `write_conversions` with the beams of several polarisations in one file."""
    try:
        write_power_beam(folder / "beam.beamfits", **map_beams(*contents))
    except Exception as error:  # whatever it is, the result itself is there
        for part in folder.glob("beam*.beamfits"):
            part.unlink()
        reason = " ".join(str(error).split())
        caution = f"beam.beamfits could not be written ({reason}); the beam is in posterior.h5, as map_mean."
        warn([caution])
        _add_warning(folder / "summary.json", caution)


def map_beams(*contents: PosteriorFile) -> dict[str, Any]:
    """Return the MAP beams, (Npols, Nfreqs, 91, 360), and what is said of them, as `write_power_beam` takes them.

    Each of the ``contents``, of the same channels, is of one polarisation.
    """
    content = contents[0]
    version = content.provenance["versions"]["hydrabeam_mpi"]
    return {
        "values": np.array([[record.arrays["map_mean"] for record in one.channels] for one in contents]),
        "freqs": np.array([record.freq for record in content.channels]),
        "pols": [one.polarization for one in contents],
        "telescope_name": content.telescope_name,
        "history": f"Maximum a posteriori beam inferred by hydrabeam_mpi {version}.",
    }


def _add_warning(path: Path, caution: str) -> None:
    """Add a warning to a summary that is there already, unless the disk is full."""
    summary = json.loads(path.read_text())
    summary["warnings"].append(caution)
    try:
        with replacing(path) as partial:
            write_json(partial, summary)
    except OSError as error:
        warn([f"nor could that be added to summary.json ({error.strerror})"])


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write a table of JSON, indented."""
    path.write_text(json.dumps(content, indent=2) + "\n")
