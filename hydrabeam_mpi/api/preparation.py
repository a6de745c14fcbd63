"""What all runs begin with: the problem on every rank, and a look at the health of its data."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from hydrabeam_mpi.api.setup import Setup
from hydrabeam_mpi.config import Job
from hydrabeam_mpi.config.named import expand
from hydrabeam_mpi.data.observation import Observation
from hydrabeam_mpi.fit.clock import Clock
from hydrabeam_mpi.fit.memory import Needed, check_room, joint_bytes, of_share
from hydrabeam_mpi.io.disk import check_space
from hydrabeam_mpi.io.uvsource import Data
from hydrabeam_mpi.mpi import (
    Comm,
    ProcessGrid,
    bcast_object,
    together,
)
from hydrabeam_mpi.result.output import least_result_bytes
from hydrabeam_mpi.setup.earlier import check_not_counted
from hydrabeam_mpi.setup.earth_table import share_earth_table
from hydrabeam_mpi.setup.flagged import without_flagged
from hydrabeam_mpi.setup.given import NOTHING, Given
from hydrabeam_mpi.setup.held import hold
from hydrabeam_mpi.setup.polarizations import check_can_be_together, prepare_each
from hydrabeam_mpi.setup.problem import Problem, estimate_noise
from hydrabeam_mpi.setup.selected import observe
from hydrabeam_mpi.simulation.mock import simulate_to
from hydrabeam_mpi.terminal.progress import say, warn


def prepare_checked(
    setup: Setup,
    folder: Path | None,
    clock: Clock,
    check: Callable[[ProcessGrid, Problem], Problem],
    needed: Needed | None = None,
) -> tuple[ProcessGrid, Problem, Problem]:
    """Set up the problem and look at the health of its data.

    Collective: all ranks of the setup.

    Parameters
    ----------
    setup : Setup
    folder : Path, optional
        As of `prepare_shared_each`.
    clock : Clock
        Receives the phases "prepare" and "health".
    check : callable
        `hydrabeam_mpi.loop.checks.health.told` or ``mended``.
    needed : callable, optional
        How many bytes a rank's share needs; by default those of a fit with effects.

    Raises
    ------
    InputError
        On all ranks, if that is more than there is, or something in the job or in a file is wrong.

    Returns
    -------
    grid : ProcessGrid
    problem, mine : Problem
        Of all channels, and of the rank group's.
    """
    with setup.telling():
        _ = setup.job.data.pol  # of which there is one
    grid, (problem,) = prepare_checked_each(setup, folder, clock, check, needed or of_share(joint_bytes))
    return grid, problem, problem.of_channels(grid.channels)


def prepare_checked_each(
    setup: Setup,
    folder: Path | None,
    clock: Clock,
    check: Callable[[ProcessGrid, Problem], Problem],
    needed: Needed,
) -> tuple[ProcessGrid, list[Problem]]:
    """Set up the problem of each polarisation, of all channels, and look at the health of its data.

    Collective: all ranks of the setup. Parameters and errors as of `prepare_checked`.
    """
    with clock.time("prepare"):
        problems = prepare_shared_each(setup.comm, setup.job, folder, setup.given)
    grid = ProcessGrid.split(setup.comm, problems[0].observation.Nfreqs)
    check_room(grid, problems, needed)
    checked = []
    with clock.time("health"):
        for problem in problems:
            say(f"looking at {problem.observation.pols[0]}", grid.is_world_root and len(problems) > 1)
            checked.append(check(grid, problem))
    return grid, checked


def prepare_shared_each(world: Comm, job: Job, folder: Path | None, given: Given = NOTHING) -> list[Problem]:
    """Simulate where asked, and set up the problem of each polarisation on every rank.

    Collective: all ranks of `world`.

    Parameters
    ----------
    world : Comm
    job : Job
    folder : Path, optional
        Where simulated data and the result go; None where neither is written.
    given : Given
        What is in memory, on rank 0.

    Raises
    ------
    InputError
        On all ranks, if something in the job or in a file is wrong, or ``folder`` has no room for the result.
    """
    with together(world):
        check_can_be_together(job, given)
        if world.rank == 0 and folder:
            check_space(folder, least_result_bytes(job))
    truths = simulate_to(world, job, folder).beams if job.data.simulate and folder else {}
    simulated = (folder / "data.uvh5",) if job.data.simulate and folder else ()
    files, job, observation = look_at_data(world, job, simulated, given)
    problems: list[Problem] = []
    with together(world):
        if world.rank == 0:
            say("reading sky and beam")
            problems = prepare_each(job, files, truths, given, observation)
            if folder:
                check_space(folder, least_result_bytes(job, observation.Nfreqs))
            say(_one_line(problems))
            warn(list(dict.fromkeys(line for problem in problems for line in problem.cautions)))
            problems = [replace(problem, files=()) for problem in problems]
    problems = [replace(problem, files=files) for problem in bcast_object(world, problems)]
    if not simulated:
        share_earth_table(world)
    if earlier := problems[0].earlier:
        check_not_counted(world, files, problems[0].observation, earlier)
    return [estimate_noise(world, problem) for problem in problems]


def look_at_data(
    world: Comm, job: Job, simulated: tuple[Path, ...], given: Given
) -> tuple[tuple[Data, ...], Job, Observation]:
    """Return the files, on every rank, what they say of themselves, and the job that leaves out what is flagged.

    Collective: all ranks of `world`. Channels without data are left out unless something is known of them already.
    """
    named: tuple[Data, ...] = ()
    with together(world):
        if world.rank == 0:
            say("reading metadata")
            named = simulated or given.data or expand(job.data.files, "[data] files")
    files = hold(world, named)
    seen: tuple[Observation | None, bool] = None, False
    with together(world):
        if world.rank == 0:
            # What a prior of its own says of a channel is not lost where these data say nothing of it.
            earlier = given.earlier is not None or (job.prior.file is not None and job.prior.file.is_dir())
            seen = observe(job, files), bool(simulated) or earlier or len(given.priors or ()) > 1
    observation, keeps_all = bcast_object(world, seen)
    return (files, job, observation) if keeps_all else (files, *without_flagged(world, job, files, observation))


def _one_line(problems: Sequence[Problem]) -> str:
    """Say what is inferred from what."""
    problem = problems[0]
    observation, basis = problem.observation, problem.basis
    several = f" of {', '.join(one.observation.pols[0] for one in problems)}" if len(problems) > 1 else ""
    return (
        f"{basis.n_modes} {'complex' if basis.is_complex else 'real'} coefficients in {observation.Nfreqs} channel(s)"
        f"{several}"
        f" from {len(problem.train.times)} times x {len(problem.train.bls)} baselines"
        f" ({problem.n_unique_baselines} unique), {problem.sky.Nsrc} sources"
    )
