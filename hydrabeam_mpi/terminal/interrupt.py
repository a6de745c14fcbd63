"""Ctrl-C, and what a batch system sends to a job that it ends."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

AGAIN_S = 0.05


@contextmanager
def interruptible() -> Iterator[None]:
    """Let SIGINT and SIGTERM end the block with `KeyboardInterrupt`, whatever code they meet.

    Where a module is being imported, Python turns the exception into another; where an object is being deleted,
    it prints the exception and goes on.

    Raises
    ------
    KeyboardInterrupt
        Once a signal has come.
    """
    came = False

    def interrupt(number: int, frame: FrameType | None) -> None:
        nonlocal came
        came = True
        raise KeyboardInterrupt

    def again(lost: sys.UnraisableHookArgs) -> None:
        if isinstance(lost.exc_value, KeyboardInterrupt):
            threading.Timer(AGAIN_S, signal.pthread_kill, [threading.get_ident(), signal.SIGINT]).start()
        else:
            previous_hook(lost)

    previous = {number: signal.signal(number, interrupt) for number in (signal.SIGINT, signal.SIGTERM)}
    previous_hook, sys.unraisablehook = sys.unraisablehook, again
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
