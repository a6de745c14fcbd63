"""Reading with other packages: any failure becomes one line, and no reader takes more memory than there is."""

from __future__ import annotations

import json
import os
import re
import resource
import stat
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.memory import free_bytes

DAMAGED = "check it, or copy or write it again"
"""The remedy where nothing better is known."""
_LONGEST = 160
"""Characters of a reader's own words that are passed on: about what fits on a line beside a path."""
_OF_THE_READER = (ArithmeticError, AssertionError, AttributeError, IndexError, NameError, TypeError, RecursionError)
"""Exceptions that speak of the reader's code and not of the file."""


@contextmanager
def reading(path: Path, what: str, *, field: str | None = None, remedy: str = DAMAGED) -> Iterator[None]:
    """Read with another package: its warnings are silenced, and all that it raises becomes one line.

    Parameters
    ----------
    path : Path
    what : str
        What the file is read as: "uvh5", "gains", "a beam".
    field : str, optional
        The key of the job that names the file.
    remedy : str

    Raises
    ------
    InputError
        If anything fails in the block, also for want of memory. One that is raised in it goes through.
    """
    try:
        with quiet(), _within_memory(path):
            yield
    except InputError as error:
        error.locate(path)
        raise
    except Exception as error:  # readers and the parsers beneath them raise whatever occurs to them
        reason = plain_words(error, path)
        told = f"cannot be read as {what}" + (f" ({reason})" if reason else "")
        raise InputError(told, file=path, field=field, remedy=remedy) from error


def read_json(path: Path, *, what: str = "JSON", remedy: str) -> dict[str, Any]:
    """Read a table of JSON.

    Raises
    ------
    InputError
        If there is no such file, or it holds no table.
    """
    check_file(path, remedy=remedy)
    with reading(path, what, remedy=remedy):
        table = json.loads(path.read_text(encoding="utf-8"))
    if not isinstance(table, dict):
        raise InputError("is not a table", file=path, remedy=remedy)
    return table


@contextmanager
def quiet() -> Iterator[None]:
    """Silence the warnings that pyuvdata and others raise on almost every file."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


@contextmanager
def mute() -> Iterator[None]:
    """Silence what libraries in C print past Python, on both streams."""
    sys.stdout.flush()
    sys.stderr.flush()
    kept = [os.dup(stream) for stream in (1, 2)]
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        for stream in (1, 2):
            os.dup2(nowhere, stream)
        yield
    finally:
        for stream, copy in zip((1, 2), kept, strict=True):
            os.dup2(copy, stream)
        for handle in (*kept, nowhere):
            os.close(handle)


def check_file(path: Path, *, field: str | None = None, remedy: str = "check the path") -> None:
    """Make sure that there is a file that may be read.

    Raises
    ------
    InputError
        If there is none, it is a folder, or it may not be read.
    """
    try:
        mode = path.stat().st_mode
        if stat.S_ISREG(mode):
            with path.open("rb"):
                return
        message = "a folder, not a file" if stat.S_ISDIR(mode) else "not an ordinary file"
    except FileNotFoundError:
        message = "no such file"
    except OSError as error:
        message = f"cannot be read ({error.strerror})"
    except ValueError:
        message = "not a file name"
    raise InputError(message, file=path, field=field, remedy=remedy)


def plain_words(error: Exception, path: Path | None = None) -> str:
    """Return a reader's own words for what is wrong with a file, as far as they speak of the file."""
    if isinstance(error, MemoryError):
        return "it asks for more memory than there is"
    if isinstance(error, _OF_THE_READER):
        return "its parts do not fit together"
    said = error.args[0] if isinstance(error, KeyError) and error.args else error
    text = getattr(error, "strerror", None) or " ".join(str(said).split())
    text = _without_machinery(str(text).replace(f"{path}", path.name if path else ""))
    if isinstance(error, KeyError) and re.fullmatch(r"\S*", text):
        return f"it lacks {text}" if text else ""
    return _shortened(text)


def _without_machinery(text: str) -> str:
    """Leave out what says nothing to users: names of classes, what HDF5 was about to do, advice on calls."""
    for system in re.findall(r"error message = '([^']*)'", text):
        return str(system)
    text = re.sub(r"^(['\"])(.*)\1$", r"\2", text)
    text = re.sub(r"^(\[Errno \d+\] )?(Unable|Can't) to (synchronously )?[^(]*\((.*)\)$", r"\4", text)
    text = re.sub(r"^truncated file: .*", "truncated file", text)
    text = re.sub(r"<(?:class|enum) '(?:\w+\.)*(\w+)'>", r"\1", text)
    text = re.sub(r"\bUVParameter _?", "", text)
    text = re.sub(r"np\.\w+\((.*?)\)", r"\1", text)
    return re.sub(r", fix it first with .*", "", text)


def _shortened(text: str) -> str:
    """Cut a long text, after a sentence where one ends."""
    if len(text) <= _LONGEST:
        return text.rstrip(". ")
    ends = [match.start() for match in re.finditer(r"[.;] ", text[:_LONGEST])]
    return text[: ends[-1]] if ends else text[: text.rfind(" ", 0, _LONGEST)] + " ..."


@contextmanager
def _within_memory(path: Path) -> Iterator[None]:
    """Make allocations fail that exceed the machine's free memory, as sizes in a damaged header ask for.

    Without it the system would grant them and end the process, or another one, once they are filled. The file's own
    size comes on top, as it may be mapped into memory. Systems other than Linux do not tell what is free.
    """
    free = free_bytes()
    if free is None:
        yield
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
    limit = free + _size(path)
    if hard != resource.RLIM_INFINITY:
        limit = min(limit, hard)
    if soft != resource.RLIM_INFINITY:
        limit = min(limit, soft)
    resource.setrlimit(resource.RLIMIT_DATA, (limit, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))


def _size(path: Path) -> int:
    """Return the size of a file, or of all files of a folder, in bytes."""
    try:
        return sum(part.stat().st_size for part in (path.rglob("*") if path.is_dir() else [path]))
    except OSError:
        return 0
