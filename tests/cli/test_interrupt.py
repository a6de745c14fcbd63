"""A signal ends the program wherever it comes."""

from __future__ import annotations

import os
import signal
import time

import pytest

from hydrabeam_mpi.terminal.interrupt import interruptible

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
