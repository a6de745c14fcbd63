"""A result and the data to which it is applied: what `predict` and `correct` share."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from hydrabeam_mpi.api.result import Found, Result, load
from hydrabeam_mpi.api.setup import Setup
from hydrabeam_mpi.api.shared import prepare_checked
from hydrabeam_mpi.config.sections import Holdout, Prior
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.fit.applied import apply_fit
from hydrabeam_mpi.fit.carried_over import CarriedOver
from hydrabeam_mpi.fit.clock import Clock
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.state import Fitted
from hydrabeam_mpi.io.inferred import Inferred
from hydrabeam_mpi.loop.checks.health import told
from hydrabeam_mpi.mpi import Comm, together
from hydrabeam_mpi.setup.problem import Problem
from hydrabeam_mpi.terminal.progress import say


def load_shared(world: Comm, folder: Path) -> Result:
    """Return what is in a result folder; ranks other than 0 have its job alone. Collective: all ranks of `world`.

    Raises
    ------
    InputError
        On all ranks, if it is no such folder.
    """
    result = None
    with together(world):
        if world.rank == 0:
            result = load(folder)
    job = world.bcast(result.job if result else None)
    return result or Result(job)


def setup_for(result: Result, setup: Setup) -> Setup:
    """Return the data and the sky of a setup, to which the beam and the effects of a result are applied.

    All rows are used, and what the setup says of basis, prior, hold-out and effects is of no account.
    """
    changes = {"basis": result.job.basis, "prior": Prior(), "holdout": Holdout(kind="none"), "effects": ()}
    given = replace(setup.given, priors=None, earlier=None)
    return Setup.of(setup.job.model_copy(update=changes), setup.comm, given, setup.path)


def apply_result(
    result: Result, setup: Setup, folder: Path | None, clock: Clock
) -> tuple[Problem, FitContext, Fitted, CarriedOver]:
    """Return what `apply_fit` does. Collective: all ranks of the setup.

    Parameters
    ----------
    result : Result
        On rank 0; others have none, or the same.
    setup : Setup
        By `setup_for`.
    folder : Path, optional
        For simulated data.
    clock : Clock
    """
    grid, problem, _ = prepare_checked(setup, folder, clock, told)
    inferred = None
    with together(grid.world):
        if grid.is_world_root:
            inferred = Inferred.of(result.content, result.path)
            had_effects = isinstance(result, Found) or result.job.effects
            if had_effects and result.content.effects is None:
                raise InputError(
                    "does not have the errors that beam and effects share",
                    file=result.path,
                    field="effects",
                    remedy="make the result again with this version",
                )
    with clock.time("read"):
        applied = apply_fit(grid, problem, inferred)
    if grid.is_world_root:
        for line in applied[-1].lines:
            say(line)
    return applied
