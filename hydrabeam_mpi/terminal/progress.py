"""Progress on rank 0: a bar on a terminal, a few plain lines in a batch log."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable, Iterator
from typing import TypeVar

from tqdm import tqdm

T = TypeVar("T")
SECONDS = 30.0
"""At most so long nothing is said where work goes on."""
_last = [time.monotonic()]


def track(items: Iterable[T], total: int, label: str, show: bool) -> Iterator[T]:
    """Pass ``items`` through and tell how far they are.

    Parameters
    ----------
    items : iterable
    total : int
        Number of items.
    label : str
        What is being done.
    show : bool
        True on one rank only. Its own share stands for all: ranks are balanced by cost.
    """
    if not show:
        yield from items
    elif sys.stderr.isatty():
        yield from tqdm(items, total=total, desc=label, leave=False)
    else:
        yield from _lines(items, total, label)


def _lines(items: Iterable[T], total: int, label: str) -> Iterator[T]:
    """Print a line now and then; short work prints nothing."""
    _last[0] = time.monotonic()
    for done, item in enumerate(items, 1):
        yield item
        say_meanwhile(f"{label}: {done} of {total}", show=True)


def say(line: str, show: bool = True) -> None:
    """Print one line of progress to standard error, where ``show`` is set."""
    if show:
        _last[0] = time.monotonic()
        print(f"hydrabeam: {line}", file=sys.stderr, flush=True)


def say_meanwhile(line: str, show: bool) -> None:
    """Print a line of progress where nothing has been said for long and ``show`` is set."""
    if time.monotonic() - _last[0] > SECONDS:
        say(line, show)


def warn(cautions: Iterable[str]) -> None:
    """Say what a user should not overlook, a line each."""
    for caution in cautions:
        say(f"warning: {caution}")
