"""Whether the tasks that a scheduler or launcher has started are the ranks of one world."""

from __future__ import annotations

import os
from collections.abc import Mapping

from mpi4py import MPI

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.launchers import task_of
from hydrabeam_mpi.mpi.failure import Shared, share
from hydrabeam_mpi.mpi.library import library_version


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
    task = task_of(environment)
    if task is not None:
        error = InputError(
            f"1 rank, but {task.variable}={task.n_tasks}: each task would do the whole run by itself",
            remedy=f"launch with srun --mpi=..., or with the mpiexec of {library_version()};"
            f" if that is what is wanted, unset {task.variable}",
        )
        share(error, Shared(n_ranks=1, speaks=task.is_first))
        raise error
