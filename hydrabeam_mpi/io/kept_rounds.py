"""Rounds of a loop on disk, or the fit before the first: in a folder that is filled, or in what an ended loop left.

Only the last round is kept, as it tells of all before it. It is a folder that appears whole, with the files that a
result would have at that point, and with Python objects, each in a file that begins with the checksum of the rest.
"""

from __future__ import annotations

import hashlib
import io
import json
import pickle
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from enum import Enum
from importlib import import_module
from pathlib import Path
from typing import Any

from hydrabeam_mpi.errors import InputError

ROUNDS = "rounds"
PACKAGE = "hydrabeam_mpi"
OF_NUMPY = {"ndarray", "dtype", "_reconstruct", "scalar", "_frombuffer"}
"""What NumPy's own objects are made with."""
READABLE = ("loop.json", "amended.toml", "job.toml", "provenance.json")
"""Files that a round and a result have in common."""
OBJECT = ".object"


@contextmanager
def new_round(folder: Path, number: int) -> Iterator[Path]:
    """Give a folder to write a round into, which then takes the place of the round before, or of one of its number."""
    place = folder / ROUNDS
    partial = place / ".new"
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    yield partial
    new, same = place / f"{number:04d}", place / ".same"
    shutil.rmtree(same, ignore_errors=True)
    if new.exists():
        new.rename(same)
    partial.rename(new)
    shutil.rmtree(same, ignore_errors=True)
    for older in _numbered(folder)[:-1]:
        shutil.rmtree(older)


def latest_round(folder: Path) -> Path | None:
    """Return the folder of the last round that is kept in ``folder``; None where there is none."""
    return next(reversed(_numbered(folder)), None)


def number_of(kept: Path) -> int:
    """Return how many rounds had ended."""
    return int(kept.name)


def rounds_words(kept: Path) -> str:
    """Say what is kept in the folder of a round."""
    n = number_of(kept)
    return f"{n} round(s)" if n else "the fit before the first round"


def check_ended(folder: Path) -> None:
    """Make sure that a folder is not what a loop left that was interrupted.

    Raises
    ------
    InputError
        If it is.
    """
    if latest_round(folder) is not None:
        remedy = "run its command again to go on, or 'hydrabeam infer' with its amended.toml"
        raise InputError(
            "is of a loop that was interrupted: it has rounds, and no posterior", file=folder, remedy=remedy
        )


def settle(folder: Path) -> None:
    """Make a result of the last round: its files beside it."""
    kept = latest_round(folder)
    assert kept is not None
    for hidden in (".new", ".same"):
        shutil.rmtree(folder / ROUNDS / hidden, ignore_errors=True)
    for name in READABLE:
        shutil.copyfile(kept / name, folder / name)


def drop_rounds(folder: Path) -> None:
    """Remove what is kept of the rounds, now that there is a result."""
    shutil.rmtree(folder / ROUNDS, ignore_errors=True)


def take_over(kept: Path, folder: Path) -> None:
    """Copy a round that is kept elsewhere into ``folder``."""
    with new_round(folder, number_of(kept)) as place:
        shutil.copytree(kept, place, dirs_exist_ok=True)


def origin_of(kept: Path) -> dict[str, Any]:
    """Return the job, the checksums and the versions of a round's provenance; empty where that is damaged."""
    try:
        about = json.loads((kept / "provenance.json").read_text(encoding="utf-8"))
        return {key: about[key] for key in ("job", "sha256", "versions")}
    except (OSError, ValueError, KeyError, TypeError):
        return {}


def write_object(path: Path, value: object) -> None:
    """Write a Python object with its checksum."""
    content = pickle.dumps(value)
    path.with_suffix(OBJECT).write_bytes(hashlib.sha256(content).digest() + content)


def read_object(path: Path) -> Any:
    """Read a Python object, if it is whole and made of nothing but this package's classes and arrays.

    Raises
    ------
    InputError
        If it is not.
    """
    path = path.with_suffix(OBJECT)
    try:
        content = path.read_bytes()
        size = hashlib.sha256().digest_size
        if hashlib.sha256(content[size:]).digest() != content[:size]:
            raise pickle.UnpicklingError("its checksum does not match")
        return _OwnClasses(io.BytesIO(content[size:])).load()
    except (OSError, pickle.UnpicklingError, EOFError, AttributeError, ImportError, KeyError) as error:
        remedy = "remove that folder to begin anew"
        raise InputError(f"cannot be read ({error})", file=path, remedy=remedy) from error


class _OwnClasses(pickle.Unpickler):
    """Makes no objects but those that this package writes: others could do anything."""

    def find_class(self, module: str, name: str) -> Any:
        """Return a class of this package, or what NumPy makes arrays with."""
        root = module.split(".")[0]
        if (module, name) == ("builtins", "getattr"):
            return _member
        if root == "numpy" and name in OF_NUMPY:
            return super().find_class(module, name)
        if root == PACKAGE:
            found = getattr(import_module(module), name)
            if isinstance(found, type):
                return found
        raise pickle.UnpicklingError(f"{module}.{name} has no business here")


def _member(of: Any, name: str) -> Enum:
    """Return a member of an enumeration, which some versions of Python write as an attribute of that."""
    if not (isinstance(of, type) and issubclass(of, Enum)):
        raise pickle.UnpicklingError(f"an attribute {name} has no business here")
    return of[name]


def _numbered(folder: Path) -> list[Path]:
    """List the rounds in a folder, the last one at the end."""
    place = folder / ROUNDS
    if not place.is_dir():
        return []
    return sorted(found for found in place.iterdir() if found.name.isdecimal() and found.is_dir())
