"""What messages between ranks cost: the time until one arrives, alpha, and the seconds a byte takes, beta."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from hydrabeam_mpi.mpi import Comm, allreduce_sum

LARGE = 2**22
"""Bytes of a sum that takes long by its size, and not by the number of its messages."""
REPEATS = 5
"""Of which the fastest counts: others were held up by something else."""


@dataclass(frozen=True)
class Network:
    """Seconds of a message of n bytes: alpha + beta n.

    Attributes
    ----------
    alpha, beta : float
        Seconds; seconds a byte.
    measured : bool
        Between the ranks that there are, or assumed.
    """

    alpha: float
    beta: float
    measured: bool

    def allreduce(self, n_bytes: int, ranks: int) -> float:
        """Return the seconds of a sum over ranks of so many bytes.

        Each rank sends a part to every other one, sums its own and sends that on; see `allreduce_sum`.
        """
        return 2 * (ranks - 1) * (self.alpha + self.beta * n_bytes / ranks)

    def message(self, n_bytes: int) -> float:
        """Return the seconds of one message."""
        return self.alpha + self.beta * n_bytes


TYPICAL = Network(2e-6, 1e-10, measured=False)
"""InfiniBand: 2 microseconds, and 10 GB/s, of which the ranks of a node have their share."""


def measure_network(world: Comm) -> Network:
    """Time sums over ranks; with one rank there is nothing to time. Collective: all ranks of `world`."""
    if world.size == 1:
        return TYPICAL
    seconds = []
    for size in (world.size, LARGE // 8):
        array, taken = np.zeros(size), []
        for _ in range(REPEATS):
            world.barrier()
            start = time.perf_counter()
            allreduce_sum(world, array)
            taken.append(max(world.allgather(time.perf_counter() - start)))
        seconds.append(min(taken))
    steps = 2 * (world.size - 1)
    return Network(seconds[0] / steps, max(seconds[1] - seconds[0], 0.0) / steps / (LARGE / world.size), True)
