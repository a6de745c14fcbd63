"""A signal ends the program wherever it comes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from hydrabeam_mpi.terminal.interrupt import interruptible, leaving, unbroken
from tests.launched import environment, passed_on

SIGNALS = pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])


def send(number: signal.Signals) -> None:
    os.kill(os.getpid(), number)
    time.sleep(5)  # which the signal ends


@SIGNALS
def test_a_signal_interrupts(number: signal.Signals) -> None:
    with pytest.raises(KeyboardInterrupt), interruptible():
        send(number)


@SIGNALS
def test_where_python_makes_another_exception_of_it(number: signal.Signals) -> None:
    class Attribute:
        def __set_name__(self, owner: type, name: str) -> None:
            send(number)

    with pytest.raises(KeyboardInterrupt), interruptible():
        type("Interruptible", (), {"attribute": Attribute()})


@SIGNALS
def test_where_python_goes_on(number: signal.Signals, capfd: pytest.CaptureFixture[str]) -> None:
    class Deleted:
        def __del__(self) -> None:
            send(number)

    def work() -> None:
        thing = Deleted()
        del thing
        time.sleep(5)

    started = time.monotonic()
    with pytest.raises(KeyboardInterrupt), interruptible():
        work()
    assert time.monotonic() - started < 4
    assert "Traceback" not in capfd.readouterr().err


def test_other_errors_and_handlers_stay_as_they_are() -> None:
    before = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)
    with pytest.raises(ValueError, match="plain"), interruptible():
        raise ValueError("plain")
    assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)) == before


@SIGNALS
def test_what_is_unbroken_comes_to_its_end(number: signal.Signals) -> None:
    done = []

    def work() -> None:
        with unbroken():
            with unbroken():
                os.kill(os.getpid(), number)
                time.sleep(0.1)
            done.append("all")
        done.append("more")

    with pytest.raises(KeyboardInterrupt), interruptible():
        work()
    assert done == ["all"]


def test_a_second_signal_does_not_break_off_what_the_first_has_begun() -> None:
    done = []

    def work() -> None:
        try:
            send(signal.SIGINT)
        finally:
            signal.raise_signal(signal.SIGTERM)
            signal.raise_signal(signal.SIGINT)
            done.append("left")

    with pytest.raises(KeyboardInterrupt), interruptible():
        work()
    assert done == ["left"]


WAITS = """
import sys
import time
from pathlib import Path
from mpi4py import MPI
from hydrabeam_mpi.terminal.interrupt import interruptible, leaving
from hydrabeam_mpi.mpi import end_interrupted, install_abort_hook

world = MPI.COMM_WORLD
install_abort_hook(world)
with interruptible(None if world.rank else lambda: end_interrupted(world)), leaving(Path(sys.argv[1]).touch):
    world.Barrier()
    if world.rank:
        print("ready", flush=True)
        time.sleep(60)
    world.Barrier()
"""


@passed_on
@SIGNALS
def test_rank_0_leaves_though_it_waits_for_another(number: signal.Signals, mpiexec: Any, tmp_path: Path) -> None:
    """In MPI, where no exception reaches it; and the other, which has got one, does not end it before."""
    words = ["mpiexec", "-n", "2", sys.executable, "-c", WAITS, tmp_path / "left"]
    given = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "env": environment()}
    with subprocess.Popen(words, text=True, start_new_session=True, **given) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        os.kill(process.pid, number)
        _, err = process.communicate(timeout=300)
    assert (tmp_path / "left").exists()
    assert "hydrabeam: interrupted" in err.splitlines()
    assert "Traceback" not in err
    assert process.returncode == 130


def test_a_second_thread_goes_with_the_block() -> None:
    before = threading.active_count()
    with interruptible(lambda: None), leaving(lambda: None):
        assert threading.active_count() == before + 1
    assert threading.active_count() == before
