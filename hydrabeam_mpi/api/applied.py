"""A result and the data to which it is applied: what `predict` and `correct` share."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

from hydrabeam_mpi.api.loading import load
from hydrabeam_mpi.api.preparation import prepare_checked
from hydrabeam_mpi.api.result import Found, Result
from hydrabeam_mpi.api.setup import Setup
from hydrabeam_mpi.config import Job
from hydrabeam_mpi.config.sections import Holdout, Prior
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.fit.applied import apply_fit
from hydrabeam_mpi.fit.carried_over import CarriedOver
from hydrabeam_mpi.fit.clock import Clock
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.state import Fitted
from hydrabeam_mpi.io.disk import writing
from hydrabeam_mpi.io.inferred import Inferred, check_unchanged
from hydrabeam_mpi.io.staging import write_folder
from hydrabeam_mpi.io.together import check_of_one
from hydrabeam_mpi.loop.checks.health import told
from hydrabeam_mpi.mpi import Comm, together
from hydrabeam_mpi.result.output import write_job_and_provenance
from hydrabeam_mpi.setup.problem import Problem
from hydrabeam_mpi.terminal.progress import say


@dataclass(frozen=True)
class Applied:
    """What comes of a result in other data; on ranks other than 0 there is nothing in it but the job.

    Attributes
    ----------
    job : Job
        The data and the sky.
    summary : dict
        What is told, in `told_in`.
    about : dict
        Where it comes from.
    """

    told_in: ClassVar[str]
    """Name of the file that has the summary."""
    job: Job
    summary: dict[str, Any] = field(default_factory=dict)
    about: dict[str, Any] = field(default_factory=dict)

    def write(self, folder: str | Path, *, overwrite: bool = False) -> None:
        """Write the folder as the command does; by rank 0 alone.

        Raises
        ------
        InputError
            If the folder exists and may not be replaced, or cannot be written.
        """
        if self.summary:
            write_folder(Path(folder), self.fill, overwrite, map(Path, self.about["sha256"]))

    def fill(self, folder: Path) -> None:
        """Write all files into an empty folder."""
        with writing(folder):
            self.write_data(folder)
            (folder / self.told_in).write_text(json.dumps(self.summary, indent=2) + "\n")
            write_job_and_provenance(folder, self.job, self.about)

    def write_data(self, folder: Path) -> None:
        """Write what there is besides the summary."""


def summary_of(
    result: Result, problem: Problem, carried: CarriedOver, numbers: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Return what is told of a result in other data, with further ``numbers``."""
    return {
        "name": problem.job.name,
        "result": str(result.path.parent) if result.path else None,
        **(numbers or {}),
        **carried.summary,
        "warnings": list(problem.cautions),
    }


def load_shared(world: Comm, folder: Path) -> Result:
    """Return what is in a result folder; ranks other than 0 have its job alone. Collective: all ranks of `world`.

    Raises
    ------
    InputError
        On all ranks, if it is no such folder, or of several polarisations.
    """
    result = None
    with together(world):
        if world.rank == 0:
            check_of_one(folder)
            result = load(folder)
    job = world.bcast(result.job if result else None)
    return result or Result(job)


def read_if_named(world: Comm, result: Result | str | Path) -> Result:
    """Return a result, or what is in the folder that is named; see `load_shared`. Collective: all ranks of `world`."""
    return result if isinstance(result, Result) else load_shared(world, Path(result))


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

    Raises
    ------
    InputError
        On all ranks, if the result cannot be applied to these data, or has changed since it was written.
    """
    with together(setup.comm):
        if result.path and setup.comm.rank == 0:
            check_unchanged(result.path.parent)
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
        return apply_fit(grid, problem, inferred)


def say_carried(world: Comm, carried: CarriedOver) -> None:
    """Say which effects hold in the data."""
    for line in carried.lines if world.rank == 0 else ():
        say(line)
