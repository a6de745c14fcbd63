"""A TOML file, whatever stands in it."""

from __future__ import annotations

import codecs
import json
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hydrabeam_mpi.errors import InputError

MAX_BYTES = 2**26
"""Larger than any job: those with all parameters of all effects in them have a few MB. Larger files are data."""
MAX_INTEGER = 2**63 - 1
"""The largest whole number that TOML promises, and that arrays hold."""
UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def read_toml(path: Path) -> str:
    """Read a TOML file and return it as JSON, in which dates are texts.

    Raises
    ------
    InputError
        If it cannot be read, is not TOML, or holds what no job holds.
    """
    text = _decode(_read(path), path)
    try:
        table = tomllib.loads(text)
        for key, number in _integers(table):
            if abs(number) > MAX_INTEGER:
                raise InputError("is too large a number", file=path, field=key, remedy="it should be below 2^63")
        return json.dumps(table, default=str)
    except tomllib.TOMLDecodeError as error:
        ends = "end of document" in str(error)
        remedy = "close what is open: brackets, braces or quotation marks" if ends else "mend that line"
        raise InputError(f"is not a TOML file ({error})", file=path, remedy=remedy) from error
    except RecursionError as error:
        raise InputError(
            "is nested too deeply", file=path, remedy="'hydrabeam init' prints a job as it should be"
        ) from error
    except ValueError as error:  # of digits beyond number
        raise InputError("holds too large a number", file=path, remedy="whole numbers should be below 2^63") from error


def _read(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            content = file.read(MAX_BYTES + 1)
    except IsADirectoryError as error:
        raise InputError("is a folder", file=path, remedy="name the job file in it") from error
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", file=path, remedy="check the path") from error
    if len(content) > MAX_BYTES:
        raise InputError("is too large for a job file", file=path, remedy="name the job, which is some lines of text")
    return content


def _decode(content: bytes, path: Path) -> str:
    """Decode UTF-8, with or without the mark that some editors begin a file with."""
    if content.startswith(UTF_16):
        raise InputError("is text in UTF-16, not in UTF-8", file=path, remedy="save it as UTF-8")
    try:
        return content.decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        message = f"is not text in UTF-8 (byte {error.start + 1} is 0x{content[error.start]:02x})"
        raise InputError(message, file=path, remedy="name a job file, or save it as UTF-8") from error


def _integers(table: Any, place: str = "") -> Iterator[tuple[str, int]]:
    """Yield all whole numbers in a table with the keys that lead to them."""
    if isinstance(table, dict):
        for key, value in table.items():
            yield from _integers(value, f"{place} {key}".strip())
    elif isinstance(table, list):
        for value in table:
            yield from _integers(value, place)
    elif isinstance(table, int):
        yield place, table
