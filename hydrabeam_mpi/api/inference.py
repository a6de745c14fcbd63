"""The posterior beam of every channel: what `hydrabeam infer` and `infer` share."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hydrabeam_mpi.api.result import Result
from hydrabeam_mpi.api.setup import Setup
from hydrabeam_mpi.api.shared import (
    begun,
    gather_records,
    make_result,
    origin_of,
    over_frequency_told,
    prepare_checked,
    prior_told,
)
from hydrabeam_mpi.fit.channels import ChannelResult, infer_channels
from hydrabeam_mpi.fit.clock import Clock
from hydrabeam_mpi.fit.grown import grown_problem
from hydrabeam_mpi.fit.heldout import whiten
from hydrabeam_mpi.fit.joint import channel_results, fit_with_effects, read_context
from hydrabeam_mpi.fit.memory import inference_bytes, loop_bytes
from hydrabeam_mpi.fit.rounding import MOST_SHIFT
from hydrabeam_mpi.loop.checks.health import told
from hydrabeam_mpi.loop.output.amendment import effects_found
from hydrabeam_mpi.loop.selection.heldout_numbers import heldout_numbers
from hydrabeam_mpi.mpi import peak_rss_mb, together
from hydrabeam_mpi.result.gains import gains_told
from hydrabeam_mpi.setup.earlier import integrations_of


def infer(setup: Setup) -> Result:
    """Infer the beam of every channel.

    With Gaussian noise N and prior (b_0, Sigma) the posterior of the coefficients is the Gaussian (HDBI II, eqs 10
    to 14)

        P = Sigma^-1 + A^H N^-1 A,        mean = P^-1 (Sigma^-1 b_0 + A^H N^-1 d).

    Collective: all ranks of the setup's communicator.

    Parameters
    ----------
    setup : Setup

    Returns
    -------
    Result
        What it holds is on rank 0.

    Raises
    ------
    InputError
        On all ranks, if the data or another argument cannot be used.
    """
    with begun(setup) as (folder, threads):
        return run_inference(setup, folder, threads)


def run_inference(setup: Setup, folder: Path | None, threads: int, waiting: Path | None = None) -> Result:
    """Infer the beam of every channel. Collective: all ranks of the setup.

    Parameters
    ----------
    setup : Setup
    folder : Path, optional
        For simulated data; its disk must have room for the result.
    threads : int
        BLAS threads of this rank, for the record.
    waiting : Path, optional
        Folder in which covariances wait to be written.
    """
    clock, world = Clock(), setup.comm
    needed = loop_bytes if setup.job.effects else inference_bytes
    grid, problem, mine = prepare_checked(setup, folder, clock, told, needed)
    numbers = found = carried = None
    fitted_gains: tuple[Any, ...] = ()
    if setup.job.effects or (problem.earlier and problem.earlier.entries):
        context = read_context(grid, problem, mine, clock)
        fitted = fit_with_effects(context, clock)
        with clock.time("heldout"):
            results = channel_results(context, fitted)
            numbers = heldout_numbers(context, whiten(context, fitted))
        problem = grown_problem(problem, context.setup, fitted.values, context.learned)
        found, carried = effects_found(setup.job, fitted, context.setup), context.carried
        fitted_gains = context.setup, fitted.values
    else:
        results = infer_channels(grid, mine, clock)
    with clock.time("describe"):
        records = gather_records(grid, problem, results, numbers, waiting)
        integrations = integrations_of(world, problem.files, problem.observation)
    memory = peak_rss_mb(world)
    result = Result(setup.job)
    with together(world):
        if world.rank == 0:
            run = {
                "wall_s": clock.inference,
                "phases_s": clock.seconds,
                "peak_rss_mb": memory,
                **_rounding_told(results),
                **prior_told(setup, carried),
                **gains_told(problem, records, *fitted_gains),
            }
            origin = origin_of(setup, problem, threads)
            run |= over_frequency_told(results)
            result = make_result(setup, problem, records, integrations, origin, run, (), found)
    return result


def _rounding_told(results: list[ChannelResult]) -> dict[str, Any]:
    """Return what ``summary.json`` says of mixed precision."""
    shift = results[0].rounding_shift if results else None
    return {} if shift is None else {"rounding_shift": shift, "repeated_in_double": shift > MOST_SHIFT}
