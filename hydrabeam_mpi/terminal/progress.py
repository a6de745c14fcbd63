"""Progress on rank 0: a bar on a terminal, a few plain lines in a batch log."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TypeVar

from tqdm import tqdm

from hydrabeam_mpi.words import duration

T = TypeVar("T")
SECONDS = 30.0
"""At most so long nothing is said where work goes on."""
OFTEN = 5.0
"""The same where more is to be said."""


@dataclass
class _Voice:
    """How much is said, and what has been.

    Attributes
    ----------
    quiet : bool
        Whether progress is not told.
    verbose : bool
        Whether it is told more often, with the time since ``began``.
    began, last : float
        Seconds of the clock, ``last`` being when something was last said.
    warned : set of str, optional
        Warnings that have been told, where each is told once.
    """

    quiet: bool = False
    verbose: bool = False
    began: float = field(default_factory=time.monotonic)
    last: float = field(default_factory=time.monotonic)
    warned: set[str] | None = None


_voice = [_Voice()]


@contextmanager
def loudness(*, quiet: bool = False, verbose: bool = False) -> Iterator[None]:
    """Say less, or more, in a block; errors and warnings are told in any case, the latter once."""
    _voice.append(_Voice(quiet, verbose, warned=set()))
    try:
        yield
    finally:
        _voice.pop()


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
    if not show or _voice[-1].quiet:
        yield from items
    elif sys.stderr.isatty():
        yield from tqdm(items, total=total, desc=label, leave=False)
    else:
        yield from _lines(items, total, label)


def _lines(items: Iterable[T], total: int, label: str) -> Iterator[T]:
    """Print a line now and then; short work prints nothing."""
    began = _voice[-1].last = time.monotonic()
    for done, item in enumerate(items, 1):
        yield item
        left = (time.monotonic() - began) * (total / done - 1)
        say_meanwhile(f"{label}: {done} of {total}, about {duration(left)} left", show=done < total)


def tell(line: str) -> None:
    """Print one line to standard error that nobody should overlook."""
    voice = _voice[-1]
    voice.last = time.monotonic()
    since = f"{voice.last - voice.began:.1f} s: " if voice.verbose else ""
    print(f"hydrabeam: {since}{line}", file=sys.stderr, flush=True)


def say(line: str, show: bool = True) -> None:
    """Print one line of progress to standard error, where ``show`` is set."""
    if show and not _voice[-1].quiet:
        tell(line)


def say_meanwhile(line: str, show: bool) -> None:
    """Print a line of progress where nothing has been said for long and ``show`` is set."""
    voice = _voice[-1]
    if time.monotonic() - voice.last > (OFTEN if voice.verbose else SECONDS):
        say(line, show)


def warn(cautions: Iterable[str]) -> None:
    """Say what a user should not overlook, a line each."""
    for caution in cautions:
        warned = _voice[-1].warned
        if warned is None or caution not in warned:
            tell(f"warning: {caution}")
        if warned is not None:
            warned.add(caution)
