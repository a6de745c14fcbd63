"""What those who start several tasks tell each of them in its environment, whether or not there is an MPI."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

LAUNCHERS = {
    "SLURM_STEP_NUM_TASKS": "SLURM_PROCID",
    "PMI_SIZE": "PMI_RANK",
    "OMPI_COMM_WORLD_SIZE": "OMPI_COMM_WORLD_RANK",
    "MV2_COMM_WORLD_SIZE": "MV2_COMM_WORLD_RANK",
    "PALS_SIZE": "PALS_RANKID",
    "FLUX_JOB_SIZE": "FLUX_TASK_RANK",
    "JSM_NAMESPACE_SIZE": "JSM_NAMESPACE_RANK",
}
"""Where launchers tell a task how many there are, and which it is: srun; MPICH's, Intel's and Cray's; Open MPI's, also
under PBS; MVAPICH's; Cray's PALS under PBS; Flux; jsrun.

`SLURM_NTASKS` is not among them: it is the size of an allocation, which a script or a shell in it has, too.
"""


@dataclass(frozen=True)
class Task:
    """One of several tasks.

    Attributes
    ----------
    variable : str
        What says how many there are.
    n_tasks : str
        How many.
    is_first : bool
        Whether this is the first of them.
    """

    variable: str
    n_tasks: str
    is_first: bool


def task_of(environment: Mapping[str, str]) -> Task | None:
    """Return which of several tasks this is, and nothing where there is only one."""
    for size, rank in LAUNCHERS.items():
        if environment.get(size, "").isdecimal() and int(environment[size]) > 1:
            return Task(size, environment[size], environment.get(rank, "0") == "0")
    return None
