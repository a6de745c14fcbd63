"""Arrays on one rank, of which others get parts when they need them, without that rank having to answer."""

from __future__ import annotations

import atexit
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from hydrabeam_mpi.mpi.collectives import bcast_object

Array = NDArray[Any]

_open: list[tuple[MPI.Comm, MPI.Win]] = []


class OneSided:
    """An array on rank 0 that all ranks can read.

    It must not change. Its memory is kept until `free_windows`, or until the process ends.

    Attributes
    ----------
    shape : tuple of int
    """

    def __init__(self, comm: MPI.Comm, array: Array | None) -> None:
        """Offer the ``array`` of rank 0. Collective: all ranks of ``comm``."""
        whole = None if array is None else np.ascontiguousarray(array)
        self.shape, self._dtype = bcast_object(comm, None if whole is None else (whole.shape, whole.dtype))
        mine = None if whole is None or comm.rank else whole.reshape(-1).view(np.uint8)
        self._window = MPI.Win.Create(mine, 1, comm=MPI.Intracomm(comm))
        _open.append((comm, self._window))

    def get(self, rows: NDArray[np.int64], second: slice) -> Array:
        """Return some rows, and of each a run along the second axis, (len(rows), second.stop - second.start, ...).

        The rank that has the array may be busy, but must come to some call of MPI.
        """
        got = np.empty((len(rows), second.stop - second.start, *self.shape[2:]), self._dtype)
        step = self._dtype.itemsize * int(np.prod(self.shape[2:]))
        starts = step * (rows * self.shape[1] + second.start)
        self._window.Lock(0, MPI.LOCK_SHARED)
        for row, start in zip(got, starts.tolist(), strict=True):
            self._window.Get([row.view(np.uint8), MPI.BYTE], 0, (start, row.nbytes, MPI.BYTE))
        self._window.Unlock(0)
        return got


def free_windows(comm: MPI.Comm) -> None:
    """Let go of the arrays that were offered so far; nobody may read them any more. Collective: all ranks of `comm`."""
    for one in [one for one in _open if one[0] == comm]:
        one[1].Free()
        _open.remove(one)


@atexit.register
def _free_all() -> None:
    """Free what is left before MPI ends, which, too, all ranks do together; libraries complain otherwise."""
    while _open and not MPI.Is_finalized():
        _open.pop(0)[1].Free()
