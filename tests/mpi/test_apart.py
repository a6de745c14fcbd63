from __future__ import annotations

import time
from collections.abc import Callable

import pytest
from mpi4py import MPI

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.mpi import apart, together

pytestmark = pytest.mark.mpi
LONG = 60.0


def work(group: MPI.Comm, listen: Callable[[], None], fails: bool) -> None:
    """Take a minute, if nobody fails."""
    began = time.monotonic()
    while time.monotonic() - began < LONG:
        with together(group):
            if group.rank == 0:
                listen()
            if fails:
                raise InputError("full disk")
        time.sleep(0.01)


@pytest.mark.parametrize("failing", [0, -1])
def test_a_group_that_fails_ends_the_others_at_once(comm: MPI.Comm, failing: int) -> None:
    """All ranks leave with its error."""
    n_groups = min(comm.size, 2)
    mine = comm.rank * n_groups // comm.size
    group, began = comm.Split(mine, comm.rank), time.monotonic()
    with pytest.raises(InputError, match="full disk"), together(comm), apart(comm, group) as listen:
        work(group, listen, mine == failing % n_groups)
    assert time.monotonic() - began < LONG / 2
    group.Free()


def test_groups_that_do_not_fail_are_waited_for(comm: MPI.Comm) -> None:
    group = comm.Split(comm.rank, comm.rank)
    done = False
    with apart(comm, group) as listen:
        listen()
        done = True
    assert done
    assert comm.allreduce(1) == comm.size
    group.Free()
