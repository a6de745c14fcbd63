"""What commands take besides their rows."""

from __future__ import annotations

import subprocess
import sys
import time
import tracemalloc

import numpy as np

from hydrabeam_mpi.api.plan import COMMANDS
from hydrabeam_mpi.planning.programs import done, loaded

MEGABYTE = 2**20


def test_what_is_made_first_is_returned_with_its_time_and_most_memory() -> None:
    made = []

    def work() -> int:
        made.append(np.ones(8 * MEGABYTE // 8).sum() + np.ones(4 * MEGABYTE // 8).sum())
        time.sleep(0.01)
        return len(made)

    number, taken = done(work, time.perf_counter)
    assert number == 1
    assert taken.seconds >= 0.01
    assert 8 * MEGABYTE <= taken.n_bytes < 9 * MEGABYTE
    assert not tracemalloc.is_tracing()


def test_memory_that_somebody_else_traces_is_left_alone() -> None:
    tracemalloc.start()
    try:
        kept = np.ones(MEGABYTE)
        _, taken = done(lambda: None, time.perf_counter)
        assert tracemalloc.get_traced_memory()[0] >= kept.nbytes
    finally:
        tracemalloc.stop()
    assert taken.n_bytes == 0


def test_what_is_loaded_already_takes_nothing_more() -> None:
    modules = list(COMMANDS.values())
    for module in modules:
        loaded(module, time.perf_counter)
    assert all(loaded(module, time.perf_counter).n_bytes < MEGABYTE for module in modules)


def test_chains_load_more_than_inferences() -> None:
    """Diagnostics of chains come with libraries of their own, which nobody else waits for."""
    script = (
        "import time; from hydrabeam_mpi.api.plan import COMMANDS; from hydrabeam_mpi.planning.programs import loaded\n"
        "print(*(loaded(COMMANDS[command], time.perf_counter).n_bytes for command in ('infer', 'sample')))"
    )
    told = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout
    infer, sample = map(int, told.split())
    assert sample > infer + 10 * MEGABYTE
