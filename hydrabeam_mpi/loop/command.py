"""`hydrabeam loop`: infer, trace the residual to effects, add them, and write all of it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from hydrabeam_mpi.config import Job
from hydrabeam_mpi.effects.base import Effect
from hydrabeam_mpi.effects.catalogue import EFFECTS, REWEIGHTINGS, SEPARATE
from hydrabeam_mpi.effects.experiment import Experiment
from hydrabeam_mpi.effects.reweighting import Reweighting
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.inference import Clock, describe_channels
from hydrabeam_mpi.io.disk import write_computed
from hydrabeam_mpi.io.provenance import provenance
from hydrabeam_mpi.loop.amendment import amended_job
from hydrabeam_mpi.loop.conventions import check_conventions
from hydrabeam_mpi.loop.drift import drifts
from hydrabeam_mpi.loop.joint import channel_results, find_experiment, read_space, restore
from hydrabeam_mpi.loop.leakage import check_leakage
from hydrabeam_mpi.loop.record import make_record
from hydrabeam_mpi.loop.refit import Space
from hydrabeam_mpi.loop.rounds import run_rounds
from hydrabeam_mpi.mpi import (
    Comm,
    ProcessGrid,
    bcast_object,
    library_version,
    peak_rss_mb,
    together,
)
from hydrabeam_mpi.output import check_records, input_files, staged, write_conversions, write_result
from hydrabeam_mpi.progress import say
from hydrabeam_mpi.run import gather_records, prepare_shared


@dataclass(frozen=True)
class Choice:
    """Which effects are looked for.

    Attributes
    ----------
    effects : list of Effect
    changes : list of Reweighting
    skipped : list of (str, str)
        Kinds that these data cannot carry, or that the job does not want, with the reason.
    leakage : bool
        Whether leakage is looked for in the other polarisations.
    """

    effects: list[Effect]
    changes: list[Reweighting]
    skipped: list[tuple[str, str]]
    leakage: bool


def close_loop(world: Comm, job: Job, job_path: Path, out: Path, overwrite: bool, threads: int) -> None:
    """Trace the residual of a job and write the amended model into ``out``.

    Collective: all ranks of `world`. Parameters and errors as of `hydrabeam_mpi.run.infer`.
    """
    clock = Clock()
    with staged(world, job_path, job, out, overwrite) as folder:
        with clock.time("prepare"):
            problem = prepare_shared(world, job, folder)
            experiment = None
            with together(world):
                if world.rank == 0:
                    experiment = find_experiment(problem)
            experiment = bcast_object(world, experiment)
        grid = ProcessGrid.split(world, problem.observation.Nfreqs)
        space = read_space(grid, problem.of_channels(grid.channels), experiment, clock)
        _check_can_confirm(space)
        with together(world):
            choice = choose(job, experiment)
            state = restore(job, experiment)
        with clock.time("conventions"):
            conventions = check_conventions(grid, space.problem, space.train.rows)
        wanted = () if conventions["found"] else ([*choice.effects, *drifts(experiment)], choice.changes)
        course = run_rounds(space, state, *(wanted or ([], [])), clock)
        with clock.time("leakage"):
            leakage = check_leakage(grid, space.problem, experiment) if choice.leakage else None
        with clock.time("describe"):
            results = channel_results(space, course.last.state)
            records = gather_records(grid, describe_channels(grid, space.problem, results))
        record = make_record(space, course, choice.skipped, conventions, leakage)
        memory = peak_rss_mb(world)
        with together(world):
            if world.rank == 0:
                check_records(records)
                about = provenance(job, input_files(job, problem), world.size, threads, library_version())
                run = {"phases_s": clock.seconds, "peak_rss_mb": memory}
                amended = amended_job(job, course.last.state, experiment)

                def write(place: Path) -> None:
                    write_result(place, job, problem, records, about, run, record["warnings"])
                    _write_loop(place, {**record, "seconds": clock.seconds}, amended)

                write_computed(folder, write)
                write_conversions(folder, problem.observation, records, about["versions"]["hydrabeam_mpi"])
    say(f"wrote {out}", world.rank == 0)


def _check_can_confirm(space: Space) -> None:
    """Make sure that some of the held-out data count. Collective: all ranks of the grid."""
    counted = space.grid.world.allreduce(np.count_nonzero(space.test.rows.inv_noise_var))
    with together(space.grid.world):
        if not counted:
            raise InputError(
                "all held-out data are flagged, and only held-out data can confirm what the loop finds",
                file=space.problem.files[0],
                field="flag_array",
                remedy="hold out others ([holdout] of the job), or correct the flags",
            )


def choose(job: Job, experiment: Experiment) -> Choice:
    """Decide which effects to look for."""
    wanted: Sequence[str] = job.loop.effects or (*EFFECTS, *REWEIGHTINGS, *SEPARATE)
    present = {entry.kind for entry in job.effects}
    choice = Choice([], [], [], leakage=False)
    for kind in wanted:
        if kind in job.loop.skip:
            choice.skipped.append((kind, "the job says so ([loop] skip)"))
        elif kind in EFFECTS:
            effect = EFFECTS[kind]()
            refusal = effect.refusal(experiment)
            if refusal is None:
                choice.effects.append(effect)
            else:
                choice.skipped.append((kind, refusal))
        elif kind in SEPARATE:
            choice = replace(choice, leakage=True)
        elif kind in REWEIGHTINGS and kind not in present:
            choice.changes.append(REWEIGHTINGS[kind]())
    return choice


def _write_loop(folder: Path, record: dict[str, Any], amended: Job) -> None:
    """Write what the loop found and the job that has it."""
    (folder / "loop.json").write_text(json.dumps(record, indent=1, allow_nan=False) + "\n")
    text = tomli_w.dumps(amended.model_dump(mode="json", exclude_none=True))
    (folder / "amended.toml").write_text(text)
