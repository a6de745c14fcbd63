"""What a command takes besides its rows: the programs that it loads, and the choice of what a loop looks for."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import TypeVar

from hydrabeam_mpi.memory import own_bytes
from hydrabeam_mpi.planning.outline import Clock

Made = TypeVar("Made")


@dataclass(frozen=True)
class Taken:
    """Seconds and bytes."""

    seconds: float = 0.0
    n_bytes: int = 0


def loaded(module: str, clock: Clock) -> Taken:
    """Load a module, and return what it takes that is not there yet."""
    before, start = own_bytes(), clock()
    import_module(module)
    return Taken(clock() - start, max(own_bytes() - before, 0))


def done(work: Callable[[], Made], clock: Clock) -> tuple[Made, Taken]:
    """Do something twice; return what it makes, the seconds of the first time, and the bytes it takes at most."""
    start = clock()
    made = work()
    seconds = clock() - start
    if tracemalloc.is_tracing():  # somebody else's, who would lose what is traced
        return made, Taken(seconds)
    tracemalloc.start()
    try:
        work()
        return made, Taken(seconds, tracemalloc.get_traced_memory()[1])
    finally:
        tracemalloc.stop()
