"""Arrays and objects between ranks, of any size.

MPI libraries count in 32 bits in places, and large messages want large hidden buffers: of arrays no more than
``max_bytes`` are sent at once, the same on all ranks. Objects go as mpi4py's pickles of protocol 5, whose arrays are
sent from where they are.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
from mpi4py import MPI
from mpi4py.util import pkl5
from numpy.typing import NDArray

MAX_MESSAGE_BYTES = 2**28  # as fast as any larger size, with less memory for buffers
TRIANGLE_STEPS = 32  # into which rows of a triangle are cut, which are sent with 3% more than the triangle

Array = NDArray[Any]
Key = TypeVar("Key", int, tuple[int, int], tuple[str, int])
Item = TypeVar("Item")


def _flat(array: Array) -> Array:
    """One-dimensional view of a contiguous array whose bytes mean the same on another rank."""
    if array.dtype.hasobject:
        raise TypeError(f"an array of {array.dtype} holds references, which mean nothing on another rank")
    if not array.flags.c_contiguous:
        raise TypeError("an array sent or summed in place must be C-contiguous")
    return array.reshape(-1)


def _pieces(flat: Array, max_bytes: int) -> Iterator[Array]:
    """Successive views of at most ``max_bytes`` (but at least one item) each."""
    step = max(1, max_bytes // flat.itemsize)
    for start in range(0, flat.size, step):
        yield flat[start : start + step]


def _messages(array: Array, max_bytes: int) -> Iterator[list[Any]]:
    """MPI buffers that together make up ``array``."""
    for piece in _pieces(_flat(array).view(np.uint8), max_bytes):
        yield [piece, MPI.BYTE]


def allreduce_sum(comm: MPI.Comm, array: Array, max_bytes: int = MAX_MESSAGE_BYTES) -> None:
    """Replace ``array`` by its sum over the ranks, on all of them. Collective: all ranks of `comm`.

    The terms are added in the order of the ranks. MPI's own reduction may take another order with another
    placement of the ranks or another network; this sum is the same bit for bit on every rank and in every run
    on as many ranks. Each rank sums its share and passes it on, which moves no more bytes than MPI's own.

    Parameters
    ----------
    comm : mpi4py.MPI.Comm
    array : ndarray, C-contiguous
        The same shape and dtype on all ranks.
    max_bytes : int
        Largest message, less than 2**31; also the size of the buffer needed.
    """
    if comm.size > 1:
        for piece in _pieces(_flat(array), max_bytes):
            _sum_in_rank_order(comm, piece)


def _sum_in_rank_order(comm: MPI.Comm, piece: Array) -> None:
    bounds = np.arange(comm.size + 1) * piece.size // comm.size
    counts, starts = np.diff(bounds) * piece.itemsize, bounds[:-1] * piece.itemsize
    terms = np.empty((comm.size, bounds[comm.rank + 1] - bounds[comm.rank]), piece.dtype)
    share = terms[0]

    comm.Alltoallv([piece, (counts, starts), MPI.BYTE], [terms, ([share.nbytes] * comm.size, None), MPI.BYTE])
    for term in terms[1:]:
        share += term
    comm.Allgatherv([share, MPI.BYTE], [piece, (counts, starts), MPI.BYTE])


def allreduce_sum_triangle(comm: MPI.Comm, matrix: Array) -> None:
    """Do as `allreduce_sum` with the lower triangle of a square matrix. Collective: all ranks of `comm`.

    Half as much is sent. What stands above the diagonal has no meaning afterwards.

    Parameters
    ----------
    comm : mpi4py.MPI.Comm
    matrix : ndarray, (n, n)
        The same shape and dtype on all ranks.
    """
    if comm.size == 1:
        return
    n, step = len(matrix), -(-len(matrix) // TRIANGLE_STEPS)
    # As long as the last of them: some rows together are copied as fast as memory allows.
    parts = [matrix[start : start + step, : start + step] for start in range(0, n, step or 1)]
    edges = np.cumsum([0, *(part.size for part in parts)])
    packed = np.empty(edges[-1], matrix.dtype)
    pieces = [packed[lo:hi].reshape(part.shape) for lo, hi, part in zip(edges, edges[1:], parts, strict=False)]
    for piece, part in zip(pieces, parts, strict=True):
        piece[...] = part
    allreduce_sum(comm, packed)
    for piece, part in zip(pieces, parts, strict=True):
        part[...] = piece


def allreduce_max(comm: MPI.Comm, array: Array, max_bytes: int = MAX_MESSAGE_BYTES) -> None:
    """Replace ``array`` by its element-wise maximum over the ranks. Collective: all ranks of `comm`.

    Parameters
    ----------
    comm : mpi4py.MPI.Comm
    array : ndarray of int or float, C-contiguous, without NaN
        The same shape and dtype on all ranks.
    max_bytes : int
        Largest message, less than 2**31.
    """
    for piece in _pieces(_flat(array), max_bytes):
        comm.Allreduce(MPI.IN_PLACE, piece, MPI.MAX)


def bcast_array(comm: MPI.Comm, array: Array | None, root: int = 0, max_bytes: int = MAX_MESSAGE_BYTES) -> Array:
    """Return the ``array`` of rank ``root`` on every rank. Collective: all ranks of `comm`.

    Parameters
    ----------
    comm : mpi4py.MPI.Comm
    array : ndarray, any shape, or None
        Read on ``root`` alone; the others need not know its shape or dtype.
    root : int
    max_bytes : int
        Largest message, less than 2**31.
    """
    if comm.rank == root:
        array = np.asarray(array, order="C")
        comm.bcast((array.shape, array.dtype), root)
    else:
        array = np.empty(*comm.bcast(None, root))
    for message in _messages(array, max_bytes):
        comm.Bcast(message, root)
    return array


def bcast_object(comm: MPI.Comm, obj: Any, root: int = 0) -> Any:
    """Return the picklable ``obj`` of rank ``root`` on every rank. Collective: all ranks of `comm`.

    Arrays in it travel by themselves and not as part of one long pickle, so that it may be of any size.
    """
    received = pkl5.Intracomm(comm).bcast(obj if comm.rank == root else None, root)
    return obj if comm.rank == root else received


def gather_objects(comm: MPI.Comm, obj: Any) -> list[Any] | None:
    """Return the picklable objects of all ranks on rank 0, None on the others. Collective: all ranks of `comm`.

    One message after the other, so that they need not fit into one together.
    """
    if comm.rank:
        send_object(comm, obj, dest=0)
        return None
    return [obj, *(recv_object(comm, source) for source in range(1, comm.size))]


def gather_items(comm: MPI.Comm, items: Mapping[Key, Item]) -> dict[Key, Item] | None:
    """Return what all ranks have, each by its own keys, in the order of the keys; None but on rank 0.

    Collective: all ranks of `comm`.
    """
    gathered = gather_objects(comm, dict(items))
    if gathered is None:
        return None
    every = {key: item for part in gathered for key, item in part.items()}
    return {key: every[key] for key in sorted(every)}


def scatter_objects(comm: MPI.Comm, objects: Sequence[Any] | None) -> Any:
    """Return on each rank its own of the picklable objects that rank 0 has. Collective: all ranks of `comm`.

    Parameters
    ----------
    comm : mpi4py.MPI.Comm
    objects : sequence, or None
        One for each rank, on rank 0.
    """
    if objects is None:
        return recv_object(comm, 0)
    for dest in range(1, comm.size):
        send_object(comm, objects[dest], dest)
    return objects[0]


def send_object(comm: MPI.Comm, obj: Any, dest: int) -> None:
    """Send a picklable object to rank ``dest``, which calls `recv_object`; it may return only once that has begun."""
    pkl5.Intracomm(comm).send(obj, dest)


def recv_object(comm: MPI.Comm, source: int) -> Any:
    """Return the object that rank ``source`` sends with `send_object`."""
    return pkl5.Intracomm(comm).recv(source=source)
