"""The posterior beam of every channel: what `hydrabeam infer` and `infer` share."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hydrabeam_mpi.api.preparation import prepare_checked_each
from hydrabeam_mpi.api.result import Result
from hydrabeam_mpi.api.results import Results
from hydrabeam_mpi.api.setup import Setup
from hydrabeam_mpi.api.shared import (
    begun,
    gather_records,
    make_result,
    origin_of,
    over_frequency_told,
    prior_told,
)
from hydrabeam_mpi.fit.channels import ChannelResult, infer_each
from hydrabeam_mpi.fit.clock import Clock
from hydrabeam_mpi.fit.grown import grown_problem
from hydrabeam_mpi.fit.joint import channel_results, fit_with_effects, read_context
from hydrabeam_mpi.fit.memory import inference_bytes, joint_bytes, of_share
from hydrabeam_mpi.fit.rounding import MOST_SHIFT
from hydrabeam_mpi.fit.whole_beams import with_whole_beams
from hydrabeam_mpi.loop.checks.health import told
from hydrabeam_mpi.loop.output.amendment import effects_found
from hydrabeam_mpi.loop.selection.heldout_numbers import HeldoutNumbers, heldout_numbers
from hydrabeam_mpi.mpi import ProcessGrid, peak_rss_mb, together
from hydrabeam_mpi.result.gains import gains_told
from hydrabeam_mpi.setup.earlier import integrations_of
from hydrabeam_mpi.setup.problem import Problem


def infer(setup: Setup) -> Result:
    """Infer the beam of every channel, and of each polarisation where ``data={"polarization": [...]}`` names several.

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
        What it holds is on rank 0. Of several polarisations `Results`, such as ``infer(setup)["nn"]``.

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
    clock = Clock()
    is_joint = bool(setup.job.effects) or setup.job.prior.widths == "evidence"
    needed = of_share(joint_bytes if is_joint else inference_bytes)
    grid, problems = prepare_checked_each(setup, folder, clock, told, needed)
    if is_joint or (problems[0].earlier and problems[0].earlier.entries):
        (problem,) = problems
        fits = [_with_effects(setup, grid, problem, clock)]
    else:
        mine = [problem.of_channels(grid.channels) for problem in problems]
        fits = list(map(_Fit, problems, infer_each(grid, mine, clock)))
    if len(fits) == 1:
        return _result(setup, grid, fits[0], threads, clock, waiting)
    results: dict[str, Result] = {}
    for pol, own, fit in zip(setup.job.data.polarization, setup.of_each_polarization(), fits, strict=True):
        part = waiting / pol if waiting else None
        with together(grid.world):
            if part and grid.world.rank == 0:
                part.mkdir()
        results[pol] = _result(own, grid, fit, threads, clock, part)
    return Results(setup.job, results)


@dataclass(frozen=True)
class _Fit:
    """What was fitted in one polarisation.

    Attributes
    ----------
    problem : Problem
        Of all channels.
    results : list of ChannelResult
        Of the rank group's channels.
    numbers : HeldoutNumbers, optional
        Where effects are in the model.
    effects : dict, optional
        See `effects_found`.
    gains : tuple
        What `gains_told` takes of effects: setup and values.
    prior : dict
        See `prior_told`.
    """

    problem: Problem
    results: list[ChannelResult]
    numbers: HeldoutNumbers | None = None
    effects: dict[str, Any] | None = None
    gains: tuple[Any, ...] = ()
    prior: dict[str, Any] = field(default_factory=dict)


def _with_effects(setup: Setup, grid: ProcessGrid, problem: Problem, clock: Clock) -> _Fit:
    """Fit beams and effects together. Collective: all ranks of the setup."""
    context = read_context(grid, problem, problem.of_channels(grid.channels), clock)
    fitted = fit_with_effects(context, clock)
    with clock.time("heldout"):
        results = channel_results(context, fitted)
        numbers = heldout_numbers(context, fitted)
    problem = grown_problem(problem, context.setup, fitted.values, context.learned)
    written = with_whole_beams(context, fitted)
    found, gains = effects_found(setup.job, written, context.setup), (context.setup, written.values)
    asked = setup.job.prior.widths == "evidence"
    told = prior_told(context.problem.job, context.carried, fitted.values, asked)
    return _Fit(problem, results, numbers, found, gains, told)


def _result(setup: Setup, grid: ProcessGrid, fit: _Fit, threads: int, clock: Clock, waiting: Path | None) -> Result:
    """Put together what rank 0 has of one polarisation; parameters as of `run_inference`.

    Collective: all ranks of the setup.
    """
    problem, world = fit.problem, setup.comm
    with clock.time("describe"):
        records = gather_records(grid, problem, fit.results, fit.numbers, waiting)
        integrations = integrations_of(world, problem.files, problem.observation)
    memory = peak_rss_mb(world)
    result = Result(setup.job)
    with together(world):
        if world.rank == 0:
            run = {
                "wall_s": clock.inference,
                "phases_s": dict(clock.seconds),
                "peak_rss_mb": memory,
                **_rounding_told(fit.results),
                **gains_told(problem, records, *fit.gains),
                **fit.prior,
            }
            origin = origin_of(setup, problem, threads)
            run |= over_frequency_told(fit.results)
            result = make_result(setup, problem, records, integrations, origin, run, (), fit.effects)
    return result


def _rounding_told(results: list[ChannelResult]) -> dict[str, Any]:
    """Return what ``summary.json`` says of mixed precision."""
    shift = results[0].rounding_shift if results else None
    return {} if shift is None else {"rounding_shift": shift, "repeated_in_double": shift > MOST_SHIFT}
