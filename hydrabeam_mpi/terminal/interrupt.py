"""Ctrl-C, and what a batch system sends to a job that it ends."""

from __future__ import annotations

import math
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from types import FrameType

AGAIN_S = 0.05
LISTENS_S = 1.0
"""Seconds within which a main thread that listens at all begins to leave by itself.

It may be writing into what it leaves, which another thread had better not remove meanwhile.
"""
SIGNALS = (signal.SIGINT, signal.SIGTERM)
AT_ONCE_S = 1.0
"""Seconds within which further signals are the same wish: a launcher and a terminal may both send one.

A second exception would break off what the first one makes the program save and remove.
"""


class _Unbroken:
    """What must not be left half done: no signal ends it, and no other thread ends the process meanwhile."""

    def __init__(self) -> None:
        self.lock = threading.RLock()
        self.depth = 0
        self.pending = False
        self.heard = -math.inf
        """When the last signal came, s."""


_unbroken = _Unbroken()
_leaving: list[Callable[[], None]] = []


@contextmanager
def unbroken() -> Iterator[None]:
    """Put off the `KeyboardInterrupt` of a signal that comes in the block to its end. For the main thread."""
    _unbroken.depth += 1
    try:
        with _unbroken.lock:
            yield
    finally:
        _unbroken.depth -= 1
        came = _unbroken.pending and not _unbroken.depth
        if came:
            _unbroken.pending = False
    if came:
        raise KeyboardInterrupt


@contextmanager
def leaving(leave: Callable[[], None]) -> Iterator[None]:
    """Have ``leave`` called where a signal must end the process although the main thread does not listen."""
    _leaving.append(leave)
    try:
        yield
    finally:
        _leaving.remove(leave)


@contextmanager
def interruptible(end: Callable[[], None] | None = None) -> Iterator[None]:
    """Let SIGINT and SIGTERM end the block with `KeyboardInterrupt`, whatever code they meet.

    Where a module is being imported, Python turns the exception into another; where an object is being deleted,
    it prints the exception and goes on.

    Parameters
    ----------
    end : callable, optional
        Ends the process. With it a second thread listens as well, calls what `leaving` has been given, and then this:
        the main thread may be waiting for other ranks within MPI, where Python's signals do not reach it.

    Raises
    ------
    KeyboardInterrupt
        Once a signal has come.
    """
    came = False

    def interrupt(number: int, frame: FrameType | None) -> None:
        nonlocal came
        came = True
        before, _unbroken.heard = _unbroken.heard, time.monotonic()
        if _unbroken.depth:
            _unbroken.pending = True
        elif _unbroken.heard - before > AT_ONCE_S:
            raise KeyboardInterrupt

    def again(lost: sys.UnraisableHookArgs) -> None:
        if isinstance(lost.exc_value, KeyboardInterrupt):
            _unbroken.heard = -math.inf
            threading.Timer(AGAIN_S, signal.pthread_kill, [threading.get_ident(), signal.SIGINT]).start()
        else:
            previous_hook(lost)

    with ExitStack() as stack:
        if end is not None:
            stack.enter_context(_listening(end))
        previous = {number: signal.signal(number, interrupt) for number in SIGNALS}
        previous_hook, sys.unraisablehook = sys.unraisablehook, again
        _unbroken.heard = -math.inf
        try:
            yield
        except Exception:
            if came:
                raise KeyboardInterrupt from None
            raise
        finally:
            sys.unraisablehook = previous_hook
            for number, handler in previous.items():
                signal.signal(number, handler)


@contextmanager
def _listening(end: Callable[[], None]) -> Iterator[None]:
    """Let another thread do what a signal asks for, as soon as nothing is unbroken."""
    reader, writer = os.pipe()
    os.set_blocking(writer, False)

    def listen() -> None:
        while number := os.read(reader, 1):
            if number[0] in SIGNALS:
                time.sleep(LISTENS_S)
                # Held to the end of the process: the main thread must not begin anything else.
                _unbroken.lock.acquire()
                for leave in reversed(_leaving):
                    leave()
                end()
        os.close(reader)

    previous = signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    thread = threading.Thread(target=listen, daemon=True)
    thread.start()
    try:
        yield
    finally:
        signal.set_wakeup_fd(previous)
        os.close(writer)
        thread.join()
