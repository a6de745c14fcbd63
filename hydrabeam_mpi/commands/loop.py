"""`hydrabeam loop`: infer, trace the residual to effects, add them, and write all of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from hydrabeam_mpi.commands.job_run import prepare_shared
from hydrabeam_mpi.config import Job
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.reweighting import Reweighting
from hydrabeam_mpi.effects.registry import EFFECTS, REWEIGHTINGS, SEPARATE
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.fit.clock import Clock
from hydrabeam_mpi.fit.gauss_newton import FitContext
from hydrabeam_mpi.fit.joint import channel_results, find_setup, read_context, restore
from hydrabeam_mpi.io.disk import write_computed
from hydrabeam_mpi.io.provenance import provenance
from hydrabeam_mpi.loop.attribution.control_models import control_models
from hydrabeam_mpi.loop.checks.conventions import check_conventions
from hydrabeam_mpi.loop.checks.leakage import check_leakage
from hydrabeam_mpi.loop.output.amendment import amended_job
from hydrabeam_mpi.loop.output.record import make_record
from hydrabeam_mpi.loop.output.resume import Keeper, find_earlier, loop_texts
from hydrabeam_mpi.loop.selection.rounds import begin, run_rounds
from hydrabeam_mpi.mpi import Comm, ProcessGrid, bcast_object, gather_by_channel, library_version, peak_rss_mb, together
from hydrabeam_mpi.result.describe import describe_channels
from hydrabeam_mpi.result.output import check_records, input_files, staged, write_conversions, write_result
from hydrabeam_mpi.setup.job_file import may_go_on
from hydrabeam_mpi.setup.problem import Problem
from hydrabeam_mpi.terminal.progress import say


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

    Collective: all ranks of `world`. Parameters and errors as of `hydrabeam_mpi.commands.infer.infer`.
    """
    clock = Clock()
    earlier, replaces = None, overwrite
    with together(world):
        if world.rank == 0:
            earlier, replaces = find_earlier(job, out), overwrite or may_go_on(job, out)
    with staged(world, job_path, job, out, replaces) as folder:
        problem, context = _set_up(world, job, folder, clock)
        grid, setup = context.grid, context.setup
        with together(world):
            choice = choose(job, setup)
            values = restore(job, setup)
        with clock.time("conventions"):
            conventions = check_conventions(grid, context.problem, context.train.rows)
        wanted = () if conventions["found"] else ([*choice.effects, *control_models(setup)], choice.changes)

        @cache
        def origin() -> dict[str, Any]:
            return provenance(job, input_files(job, problem), world.size, threads, library_version())

        keep = Keeper(context, folder, choice.skipped, conventions, clock, origin)
        history = keep.go_on(earlier, out, overwrite) or begin(context, values, clock)
        run_rounds(context, history, *(wanted or ([], [])), clock, keep)
        with clock.time("leakage"):
            leakage = check_leakage(grid, context.problem, setup) if choice.leakage else None
        with clock.time("describe"):
            results = channel_results(context, history.last.fitted)
            records = gather_by_channel(grid, describe_channels(grid, context.problem, results))
        record = make_record(context, history, choice.skipped, conventions, leakage)
        memory = peak_rss_mb(world)
        with together(world):
            if world.rank == 0:
                check_records(records)
                run = {"phases_s": clock.seconds, "peak_rss_mb": memory}
                texts = loop_texts(record | {"seconds": clock.seconds}, amended_job(job, history.last.fitted, setup))

                def write(place: Path) -> None:
                    write_result(place, job, problem, records, origin(), run, record["warnings"])
                    for name, text in texts.items():
                        (place / name).write_text(text)

                write_computed(folder, write)
                write_conversions(folder, problem.observation, records, origin()["versions"]["hydrabeam_mpi"])
    say(f"wrote {out}", world.rank == 0)


def _set_up(world: Comm, job: Job, folder: Path, clock: Clock) -> tuple[Problem, FitContext]:
    """Return the problem of all channels, and the rank's part of it with its rows. Collective: all ranks of `world`."""
    with clock.time("prepare"):
        problem = prepare_shared(world, job, folder)
        setup = None
        with together(world):
            if world.rank == 0:
                setup = find_setup(problem)
        setup = bcast_object(world, setup)
    grid = ProcessGrid.split(world, problem.observation.Nfreqs)
    context = read_context(grid, problem.of_channels(grid.channels), setup, clock)
    _check_can_confirm(context)
    return problem, context


def _check_can_confirm(context: FitContext) -> None:
    """Make sure that some of the held-out data count. Collective: all ranks of the grid."""
    counted = context.grid.world.allreduce(np.count_nonzero(context.test.rows.inv_noise_var))
    with together(context.grid.world):
        if not counted:
            raise InputError(
                "all held-out data are flagged, and only held-out data can confirm what the loop finds",
                file=context.problem.files[0],
                field="flag_array",
                remedy="hold out others ([holdout] of the job), or correct the flags",
            )


def choose(job: Job, setup: ObservingSetup) -> Choice:
    """Decide which effects to look for."""
    wanted: Sequence[str] = job.loop.effects or (*EFFECTS, *REWEIGHTINGS, *SEPARATE)
    present = {entry.kind for entry in job.effects}
    choice = Choice([], [], [], leakage=False)
    for kind in wanted:
        if kind in job.loop.skip:
            choice.skipped.append((kind, "the job says so ([loop] skip)"))
        elif kind in EFFECTS:
            effect = EFFECTS[kind]()
            not_applicable = effect.not_applicable(setup)
            if not_applicable is None:
                choice.effects.append(effect)
            else:
                choice.skipped.append((kind, not_applicable))
        elif kind in SEPARATE:
            choice = replace(choice, leakage=True)
        elif kind in REWEIGHTINGS and kind not in present:
            choice.changes.append(REWEIGHTINGS[kind]())
    return choice
