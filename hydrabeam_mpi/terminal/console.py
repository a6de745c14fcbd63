"""What a run says on its terminal: one rank alone, in lines that begin with ``hydrabeam:``."""

from __future__ import annotations

import logging
import os
import sys
import warnings
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout

from hydrabeam_mpi.terminal.progress import say, warn

PACKAGE = "hydrabeam_mpi"


@contextmanager
def console(speaks: bool) -> Iterator[None]:
    """Say the package's notes and warnings as single lines on one rank, and keep the others silent.

    Warnings and log records of other packages are dropped, as they speak of code that the user did not write.
    Warnings come back, in Python's own form, with ``python -W`` or ``PYTHONWARNINGS``.

    Parameters
    ----------
    speaks : bool
        True on one rank only; on the others nothing reaches standard output or standard error.
    """
    with ExitStack() as stack:
        if not speaks:
            nowhere = stack.enter_context(open(os.devnull, "w"))
            stack.enter_context(redirect_stdout(nowhere))
            stack.enter_context(redirect_stderr(nowhere))
        stack.enter_context(_warnings_as_lines())
        stack.enter_context(_records_as_lines())
        yield


@contextmanager
def _warnings_as_lines() -> Iterator[None]:
    """Say what is warned of in the package's own lines."""
    with warnings.catch_warnings():
        if not sys.warnoptions:
            warnings.simplefilter("ignore")
            warnings.filterwarnings("default", module=rf"{PACKAGE}\b")
            # Those are for developers, and the tests show them.
            warnings.simplefilter("ignore", DeprecationWarning)
            warnings.simplefilter("ignore", PendingDeprecationWarning)
            # Of files that a run left open as it was interrupted.
            warnings.simplefilter("ignore", ResourceWarning)
            warnings.showwarning = lambda message, *_, **__: warn([_in_one_line(message)])
        yield


@contextmanager
def _records_as_lines() -> Iterator[None]:
    """Say the package's log records from "info" upwards; a handler on top keeps Python from printing others."""
    logger, ours, others = logging.getLogger(PACKAGE), _Lines(), logging.NullHandler()
    level = logger.level
    logger.setLevel(logging.INFO)
    logger.addHandler(ours)
    logging.getLogger().addHandler(others)
    try:
        yield
    finally:
        logger.setLevel(level)
        logger.removeHandler(ours)
        logging.getLogger().removeHandler(others)


class _Lines(logging.Handler):
    """Says every record."""

    def emit(self, record: logging.LogRecord) -> None:
        line = _in_one_line(record.getMessage())
        if record.levelno >= logging.WARNING:
            warn([line])
        else:
            say(line)


def _in_one_line(text: object) -> str:
    return " ".join(str(text).split())
