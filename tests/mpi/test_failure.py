from __future__ import annotations

import pytest
from mpi4py import MPI

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.mpi import ProcessGrid, together
from hydrabeam_mpi.mpi.failure import how_shared

pytestmark = pytest.mark.mpi


class Awkward(Exception):
    """Cannot be made again from its arguments."""

    def __init__(self, first: int, second: int) -> None:
        super().__init__(f"{first} and {second}")


def raise_if(condition: bool, error: Exception) -> None:
    if condition:
        raise error


def test_nothing_fails(comm: MPI.Comm) -> None:
    with together(comm):
        done = comm.rank
    assert done == comm.rank
    assert comm.allreduce(1) == comm.size


@pytest.mark.parametrize("failing", [0, -1])
def test_one_fails_and_all_raise(comm: MPI.Comm, failing: int) -> None:
    failing %= comm.size
    with pytest.raises(InputError) as caught, together(comm):
        raise_if(comm.rank == failing, InputError("is NaN", file="x.uvh5", field="data", remedy="flag it"))
    assert str(caught.value) == "x.uvh5: data: is NaN; flag it"
    assert (caught.value.file, caught.value.field) == ("x.uvh5", "data")
    assert how_shared(caught.value).n_ranks == comm.size
    assert how_shared(caught.value).speaks == (comm.rank == failing)
    notes = getattr(caught.value, "__notes__", [])
    assert [f"Raised on rank {failing}:" in note for note in notes] == [True] * (comm.rank != failing)
    assert comm.allreduce(1) == comm.size


def test_the_first_of_several_counts(comm: MPI.Comm) -> None:
    with pytest.raises(KeyError) as caught, together(comm):
        raise KeyError(comm.rank)
    assert caught.value.args == (0,)


def test_what_cannot_be_pickled(comm: MPI.Comm) -> None:
    with pytest.raises((Awkward, RuntimeError)) as caught, together(comm):
        raise_if(comm.rank == 0, Awkward(1, 2))
    assert type(caught.value) is (Awkward if comm.rank == 0 else RuntimeError)
    assert str(caught.value) == ("1 and 2" if comm.rank == 0 else "Awkward: 1 and 2")


def test_one_group_fails_and_all_groups_raise(comm: MPI.Comm) -> None:
    grid = ProcessGrid.split(comm, 2)
    last = grid.group_index == grid.n_groups - 1 and grid.group.rank == grid.group.size - 1
    with pytest.raises(InputError) as caught, together(comm), together(grid.group):
        raise_if(last, InputError("all data flagged"))
    assert how_shared(caught.value).n_ranks == comm.size
    assert comm.allreduce(how_shared(caught.value).speaks) == 1


def test_an_error_raised_alone_is_not_shared() -> None:
    assert how_shared(ValueError("alone")).n_ranks == 1
