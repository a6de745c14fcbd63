"""Whether the tasks that a scheduler or launcher has started are the ranks of one world."""

from __future__ import annotations

import os
from collections.abc import Mapping

from mpi4py import MPI

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.mpi.failure import Shared, share
from hydrabeam_mpi.mpi.library import library_version

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


def check_one_world(world: MPI.Comm, environment: Mapping[str, str] = os.environ) -> None:
    """Refuse to do the whole run in each of several tasks that do not see each other.

    So it is where srun is not told which MPI starts, or an ``mpiexec`` is of another MPI than mpi4py.

    Raises
    ------
    InputError
        If this is one of several tasks and ``world`` has one rank. It is told by the first task.
    """
    if world.size > 1:
        return
    for size, rank in LAUNCHERS.items():
        if environment.get(size, "").isdecimal() and int(environment[size]) > 1:
            error = InputError(
                f"1 rank, but {size}={environment[size]}: each task would do the whole run by itself",
                remedy=f"launch with srun --mpi=..., or with the mpiexec of {library_version()};"
                f" if that is what is wanted, unset {size}",
            )
            share(error, Shared(n_ranks=1, speaks=environment.get(rank, "0") == "0"))
            raise error
