from __future__ import annotations

import functools
import operator
from typing import Literal

import numpy as np
import pytest
from mpi4py import MPI

from hydrabeam_mpi.mpi import (
    allreduce_max,
    allreduce_sum,
    allreduce_sum_triangle,
    bcast_array,
    bcast_object,
    gather_items,
    gather_objects,
    recv_object,
    scatter_objects,
    send_object,
)
from hydrabeam_mpi.random import generator

pytestmark = pytest.mark.mpi

SHAPES = [(), (0,), (1,), (2,), (7, 5), (3, 0, 2)]
DTYPES = [np.float64, np.complex128, np.int64, np.float32]

# All in one message, in several, and one item a message even where an item is larger than the limit.
any_limit = pytest.mark.parametrize("max_bytes", [2**30, 100, 16, 1])
any_shape = pytest.mark.parametrize("shape", SHAPES)
any_dtype = pytest.mark.parametrize("dtype", DTYPES)


def term(rank: int, shape: tuple[int, ...], dtype: type) -> np.ndarray:
    """What a rank contributes: numbers of very different sizes, whose sum depends on the order."""
    rng = generator(1, "term", rank)
    real, imag = rng.standard_normal((2, *shape)) * 10.0 ** rng.integers(-8, 8, (2, *shape))
    return np.asarray(real + 1j * imag if dtype is np.complex128 else real).astype(dtype)


@any_limit
@any_shape
@any_dtype
def test_sum_is_in_rank_order(comm: MPI.Comm, shape: tuple[int, ...], dtype: type, max_bytes: int) -> None:
    array = term(comm.rank, shape, dtype)
    allreduce_sum(comm, array, max_bytes)
    expected = functools.reduce(operator.add, [term(rank, shape, dtype) for rank in range(comm.size)])
    np.testing.assert_array_equal(array, np.asarray(expected), strict=True)


def test_sum_in_place_of_a_view(comm: MPI.Comm) -> None:
    array = np.ones((4, 3))
    allreduce_sum(comm, array[1:3])
    np.testing.assert_array_equal(array[:, 0], [1, comm.size, comm.size, 1])


@pytest.mark.parametrize("n", [0, 1, 2, 31, 32, 33, 100])
@pytest.mark.parametrize("order", ["C", "F"])
@any_dtype
def test_triangle_is_summed_as_all_is(comm: MPI.Comm, n: int, order: Literal["C", "F"], dtype: type) -> None:
    matrix, whole = np.array(term(comm.rank, (n, n), dtype), order=order), term(comm.rank, (n, n), dtype)
    allreduce_sum_triangle(comm, matrix)
    allreduce_sum(comm, whole)
    np.testing.assert_array_equal(np.tril(matrix), np.tril(whole), strict=True)


@any_limit
def test_maximum(comm: MPI.Comm, max_bytes: int) -> None:
    array = np.array([[comm.rank, -comm.rank], [5.0, -np.inf]])
    allreduce_max(comm, array, max_bytes)
    np.testing.assert_array_equal(array, [[comm.size - 1, 0], [5, -np.inf]])


def test_refused_arrays(comm: MPI.Comm) -> None:
    with pytest.raises(TypeError, match="C-contiguous"):
        allreduce_max(comm, np.ones((3, 4)).T)
    with pytest.raises(TypeError, match="references"):
        bcast_array(MPI.COMM_SELF, np.array([{}, None]))


@any_limit
@any_shape
@any_dtype
@pytest.mark.parametrize("root", [0, -1])
def test_broadcast(comm: MPI.Comm, shape: tuple[int, ...], dtype: type, max_bytes: int, root: int) -> None:
    root %= comm.size
    array = bcast_array(comm, term(0, shape, dtype) if comm.rank == root else None, root, max_bytes)
    np.testing.assert_array_equal(array, term(0, shape, dtype), strict=True)
    array[...] = 1  # its own, and writeable


def test_broadcast_of_a_transpose(comm: MPI.Comm) -> None:
    array = np.arange(6).reshape(2, 3).T
    np.testing.assert_array_equal(bcast_array(comm, array if comm.rank == 0 else None), array, strict=True)


THING = {"pols": ("ee", "nn"), "freqs": np.array([1.5e8]), "nothing": None}


def assert_is_thing(found: dict) -> None:
    assert found["pols"] == THING["pols"]
    assert found["nothing"] is None
    found["freqs"] += 0.0  # an array that arrives may be written to
    np.testing.assert_array_equal(found["freqs"], THING["freqs"], strict=True)


def test_broadcast_of_an_object(comm: MPI.Comm) -> None:
    root = comm.size - 1
    assert_is_thing(bcast_object(comm, THING if comm.rank == root else None, root))


def test_objects_are_gathered_in_order_of_ranks(comm: MPI.Comm) -> None:
    mine = {"rank": comm.rank, "array": np.asfortranarray(np.full((2, 3), comm.rank))}
    found = gather_objects(comm, mine)
    if comm.rank:
        assert found is None
        return
    assert [one["rank"] for one in found] == list(range(comm.size))
    for rank, one in enumerate(found):
        np.testing.assert_array_equal(one["array"], np.full((2, 3), rank), strict=True)


def test_items_are_gathered_in_order_of_keys(comm: MPI.Comm) -> None:
    found = gather_items(comm, {("late", -comm.rank): comm.rank, ("early", comm.rank): comm.rank})
    if comm.rank:
        assert found is None
        return
    ranks = range(comm.size)
    assert list(found.items()) == [*((("early", n), n) for n in ranks), *((("late", -n), n) for n in reversed(ranks))]


def test_objects_are_dealt_out(comm: MPI.Comm) -> None:
    objects = [{"rank": rank, "array": np.full((2, 3), rank)} for rank in range(comm.size)]
    mine = scatter_objects(comm, None if comm.rank else objects)
    assert mine["rank"] == comm.rank
    np.testing.assert_array_equal(mine["array"], np.full((2, 3), comm.rank), strict=True)


def test_objects_in_a_ring(comm: MPI.Comm) -> None:
    if comm.size == 1:
        pytest.skip("one rank has nobody to send to")
    left, right = (comm.rank - 1) % comm.size, (comm.rank + 1) % comm.size
    if comm.rank == 0:
        send_object(comm, THING, right)
    assert_is_thing(recv_object(comm, left))
    if comm.rank > 0:
        send_object(comm, THING, right)
