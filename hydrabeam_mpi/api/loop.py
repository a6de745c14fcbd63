"""Infer, trace the residual to effects and add them: what `hydrabeam loop` and `close_loop` share."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from hydrabeam_mpi.api.preparation import prepare_checked
from hydrabeam_mpi.api.result import Found, Result
from hydrabeam_mpi.api.setup import Setup
from hydrabeam_mpi.api.shared import (
    begun,
    gather_records,
    make_result,
    origin_of,
    over_frequency_told,
    prior_told,
)
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.fit.clock import Clock
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.error_scale import error_scale
from hydrabeam_mpi.fit.grown import grown_problem
from hydrabeam_mpi.fit.joint import channel_results, read_context, restore
from hydrabeam_mpi.fit.prior_widths import is_adaptable
from hydrabeam_mpi.fit.whole_beams import with_whole_beams
from hydrabeam_mpi.loop.attribution.control_models import control_models
from hydrabeam_mpi.loop.checks.conventions import check_conventions, with_findings
from hydrabeam_mpi.loop.checks.health import mended
from hydrabeam_mpi.loop.checks.leakage import check_leakage
from hydrabeam_mpi.loop.memory import loop_bytes
from hydrabeam_mpi.loop.output.amendment import amended_job, effects_found
from hydrabeam_mpi.loop.output.record import make_record
from hydrabeam_mpi.loop.output.resume import Keeper
from hydrabeam_mpi.loop.selection.choice import Choice, choose
from hydrabeam_mpi.loop.selection.elsewhere import tell_elsewhere
from hydrabeam_mpi.loop.selection.first_and_last import begin, settle_last
from hydrabeam_mpi.loop.selection.history import History
from hydrabeam_mpi.loop.selection.rounds import Search
from hydrabeam_mpi.loop.selection.search import run_search
from hydrabeam_mpi.mpi import bcast_object, peak_rss_mb, together
from hydrabeam_mpi.result.gains import gains_told
from hydrabeam_mpi.setup.earlier import integrations_of
from hydrabeam_mpi.setup.job_file import check_holds_out
from hydrabeam_mpi.setup.problem import Problem


def close_loop(setup: Setup) -> Found:
    """Infer the beam, find what the model lacks, and add it.

    In each round all effects are weighed by their evidence, the beam marginalised; the best is fitted jointly with the
    beam, and stays if held-out data are predicted better by it.

    Collective: all ranks of the setup's communicator.

    Parameters
    ----------
    setup : Setup
        It must hold data out.

    Returns
    -------
    Found
        What it holds is on rank 0.

    Raises
    ------
    InputError
        On all ranks, if the data or another argument cannot be used.
    """
    with begun(setup) as (folder, threads):
        check_holds_out(setup.job)
        return run_loop(setup, folder, threads)


def run_loop(
    setup: Setup,
    folder: Path | None,
    threads: int,
    out: Path | None = None,
    earlier: Path | None = None,
    overwrite: bool = False,
) -> Found:
    """Infer, trace the residual to effects, and add them. Collective: all ranks of the setup.

    Parameters
    ----------
    setup : Setup
    folder : Path, optional
        For simulated data; its disk must have room for the result.
    threads : int
        BLAS threads of this rank, for the record.
    out : Path, optional
        Where the result will be. Rounds are kept in ``folder`` where it is given.
    earlier : Path, optional
        The round of an earlier run from which to go on, on rank 0.
    overwrite : bool
        Whether a result in ``out`` may be replaced.
    """
    clock, world, job = Clock(), setup.comm, setup.job
    grid, problem, _ = prepare_checked(setup, folder, clock, mended, loop_bytes)
    with clock.time("prepare"):
        problem = problem.with_shape(world)
    context = read_context(grid, problem, problem.of_channels(grid.channels), clock)
    _check_can_confirm(context)
    known = context.setup
    with together(world):
        chosen, values = choose(job, known), restore(job, known, context.learned)
    # Rounding may decide which points of the sky are looked at, so that rank 0 says it.
    choice: Choice = bcast_object(world, chosen)
    with clock.time("conventions"):
        conventions = check_conventions(grid, context.problem, context.train.rows)
        conventions = with_findings(conventions, context.problem.findings)
    wanted = ([], []) if conventions["found"] else ([*choice.effects, *control_models(known)], choice.changes)

    @cache
    def origin() -> dict[str, Any]:
        return origin_of(setup, problem, threads)

    history = None
    keep: Callable[[History], None] = _keep_nothing
    if folder is not None and out is not None:
        keeper = Keeper(context, folder, choice.skipped, conventions, clock, origin)
        history, keep = keeper.go_on(earlier, out, overwrite), keeper
    history = history or begin(context, values, clock, wanted[0])
    run_search(Search(context, history, *wanted, clock, keep))
    with clock.time("settle"):
        settle_last(context, history)
    with clock.time("elsewhere"):
        tell_elsewhere(context, history)
    with clock.time("leakage"):
        leakage = check_leakage(grid, context.problem, known) if choice.leakage else None
    record = make_record(context, history, choice.skipped, conventions, leakage)
    return _found(setup, problem, context, history, record, origin, clock)


def _found(
    setup: Setup,
    problem: Problem,
    context: FitContext,
    history: History,
    record: dict[str, Any],
    origin: Callable[[], dict[str, Any]],
    clock: Clock,
) -> Found:
    """Put together what was accepted, on rank 0. Collective: all ranks of the setup.

    ``problem`` is of all channels, ``record`` what `make_record` tells; ``origin`` is called on rank 0.
    """
    world, known, fitted = setup.comm, context.setup, history.last.fitted
    with clock.time("describe"):
        results = channel_results(context, fitted)
        problem = grown_problem(problem, known, fitted.values, context.learned)
        records = gather_records(context.grid, problem, results, history.last.numbers)
        integrations = integrations_of(world, problem.files, problem.observation)
    written = with_whole_beams(context, fitted)
    scale, memory = error_scale(context, fitted), peak_rss_mb(world)
    found = Found(Result(setup.job))
    with together(world):
        if world.rank == 0:
            gains = gains_told(problem, records, known, written.values)
            run = {"phases_s": clock.seconds, "peak_rss_mb": memory, **gains}
            job = context.problem.job
            asked = job.prior.widths != "stated" and is_adaptable(context)
            run |= prior_told(job, context.carried, fitted.values, asked) | over_frequency_told(results)
            effects = effects_found(problem.job, written, known)
            result = make_result(setup, problem, records, integrations, origin(), run, record["warnings"], effects)
            told = {**record, "warnings": result.summary["warnings"], "seconds": clock.seconds}
            found = Found(result, told, setup.amended(amended_job(problem.job, fitted, known, scale)))
    return found


def _keep_nothing(history: History) -> None:
    """Keep no round: there is no folder for it."""


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
