"""What a job will take: what `hydrabeam plan` and `plan` share."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from hydrabeam_mpi.api.setup import Setup
from hydrabeam_mpi.config import Job
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.memory import own_bytes
from hydrabeam_mpi.mpi import limit_blas_threads, together
from hydrabeam_mpi.planning.files import measure_files
from hydrabeam_mpi.planning.forecast import Model
from hydrabeam_mpi.planning.measure import Bench
from hydrabeam_mpi.planning.network import measure_network
from hydrabeam_mpi.planning.outline import outline
from hydrabeam_mpi.planning.programs import loaded
from hydrabeam_mpi.planning.table import as_table, as_text, assumptions
from hydrabeam_mpi.planning.told import Forecast

COMMANDS = {
    "simulate": "hydrabeam_mpi.api.simulation",
    "infer": "hydrabeam_mpi.api.inference",
    "loop": "hydrabeam_mpi.api.loop",
    "sample": "hydrabeam_mpi.api.sampling",
}
"""Commands of which there are forecasts, and the modules that they load."""


@dataclass(frozen=True)
class Plan:
    """What commands will take on numbers of ranks.

    Attributes
    ----------
    forecasts : tuple of Forecast
        With ``command``, ``ranks``, ``wall_s``, ``phases_s``, ``memory_bytes``, ``sent_bytes``, ``file_bytes``,
        ``partition``, and of a loop ``round_s``, ``anew_s`` and ``further_bytes``; on rank 0, as is all else.
    assumed : tuple of str
        What that rests on.
    """

    forecasts: tuple[Forecast, ...]
    assumed: tuple[str, ...]

    def __str__(self) -> str:
        """Return a table."""
        return as_text(self.forecasts, self.assumed)

    def as_table(self) -> dict[str, Any]:
        """Return all numbers, in seconds and bytes."""
        return as_table(self.forecasts, self.assumed)


def plan(
    setup: Setup,
    ranks: Iterable[int] = (1,),
    commands: Iterable[str] | None = None,
    found: int = 1,
    clock: Callable[[], float] = time.perf_counter,
    startup_s: float = 0.0,
) -> Plan:
    """Forecast what commands will take, without reading a visibility.

    The job's own steps are timed on a few of its rows with made-up data, on this machine as busy as it is; which takes
    seconds, or with a loop up to minutes. Collective: all ranks of the setup, between which messages are timed.

    Parameters
    ----------
    setup : Setup
    ranks : iterable of int
        On how many.
    commands : iterable of str, optional
        Of `COMMANDS`; those that the job can be given to by default.
    found : int
        Effects that a loop finds: an assumption. Zero for what is certain of it.
    clock : callable
        Tells the time in seconds. `time.process_time` forecasts seconds of the processor, on one thread.
    startup_s : float
        Seconds until a process has imported what it needs, which count as well.

    Raises
    ------
    InputError
        On all ranks, if a file or an argument cannot be used.
    """
    world = setup.comm
    network = measure_network(world)
    if world.size > 1:
        limit_blas_threads(world)
    made, ranks = Plan((), ()), tuple(ranks)
    with setup.telling(), together(world):
        if world.rank == 0:
            _ = setup.job.data.pol  # several are not forecast
            wanted = tuple(commands or possible(setup.job))
            if unknown := set(wanted) - set(possible(setup.job)):
                message = f"'{sorted(unknown)[0]}' is no command that this job can be given to"
                raise InputError(message, field="commands", remedy=f"choose of {', '.join(possible(setup.job))}")
            known = outline(setup.job, setup.given, clock)
            files = measure_files(known, clock)
            base = own_bytes()
            programs = {command: loaded(COMMANDS[command], clock) for command in wanted}
            model = Model(Bench(known, clock), files, network, startup_s, base, programs, found)
            forecasts = tuple(model.forecast(command, count) for command in wanted for count in ranks)
            made = Plan(forecasts, tuple(assumptions(network, found if "loop" in wanted else None)))
    return made


def possible(job: Job) -> list[str]:
    """Return the commands that a job can be given to."""
    mixed = job.solver.precision == "mixed"
    frequency = job.prior.frequency
    # With effects there is one length alone.
    alone = mixed or (frequency.kind == "gaussian-process" and len(frequency.length) != 1)
    left_out = {"simulate": job.data.simulate is None, "loop": alone or job.holdout.kind == "none", "sample": alone}
    return [command for command in COMMANDS if not left_out.get(command)]
