"""The files and folders that a job names, checked before anything is read."""

from __future__ import annotations

import glob
import os
import stat
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from hydrabeam_mpi.config.job import Job
from hydrabeam_mpi.config.sections import BUILT_IN_BEAMS
from hydrabeam_mpi.errors import InputError

Kind = Literal["file", "folder", "either"]
REMEDY = "check the path"


@dataclass(frozen=True)
class Named:
    """A file or folder that a job names, at which key and of which kind."""

    path: Path
    field: str
    kind: Kind
    remedy: str = REMEDY


def named_files(job: Job) -> list[Path]:
    """List all files and folders that a job names, wildcards expanded.

    Raises
    ------
    InputError
        If one is missing, or not what can be read.
    """
    data = (*expand(job.data.files, "[data] files"), *expand(job.data.gains, "[data] gains", "file"))
    return [*data, *map(_checked, (*for_simulation(job), *for_inference(job)))]


def simulation_files(job: Job) -> list[Path]:
    """List the files and folders that a job names and a simulation reads. Raises as `named_files`."""
    return [_checked(named) for named in for_simulation(job)]


def for_simulation(job: Job, in_memory: frozenset[str] = frozenset()) -> list[Named]:
    """List what a job names for a simulation or for the model: layout of the array, sky, beam."""
    array = job.data.simulate.array.file if job.data.simulate else None
    beam = None if job.beam.source in BUILT_IN_BEAMS else Path(job.beam.source)
    named = [
        *_named(array, "[data.simulate.array] file", "file"),
        *_named(job.sky.file, "[sky] file", "file"),
        *_named(job.sky.diffuse, "[sky] diffuse", "folder"),
        *_named(beam, "[beam] source", "file", f"{REMEDY}, or use {', '.join(BUILT_IN_BEAMS)}"),
    ]
    return [one for one in named if one.field not in in_memory]


def for_inference(job: Job, in_memory: frozenset[str] = frozenset()) -> list[Named]:
    """List what a job names for an inference alone: noise and prior."""
    named = [
        *_named(job.noise.file, "[noise] file", "either"),
        *_named(job.prior.file, "[prior] file", "either"),
    ]
    return [one for one in named if one.field not in in_memory]


def expand(patterns: Sequence[str], field: str, kind: Kind = "either") -> tuple[Path, ...]:
    """Expand file names with wildcards, in order of name.

    Parameters
    ----------
    patterns : sequence of str
        One that is the name of a file stands for that file, whatever is in it, and so does its beginning for a folder.
    field : str
        Of the job file, for messages.
    kind : {"file", "folder", "either"}

    Raises
    ------
    InputError
        If a pattern matches nothing, or what cannot be read.
    """
    paths: list[Path] = []
    for pattern in patterns:
        path = Path(pattern)
        # The folder of the job may have a name with brackets.
        root = next((parent for parent in (path, *path.parents) if _is_there(parent)), path)
        found = [] if root == path else sorted(glob.glob(str(path.relative_to(root)), root_dir=root))
        paths += [_checked(Named(one, field, kind)) for one in [root / name for name in found] or [path]]
    return tuple(dict.fromkeys(paths))


def _is_there(name: Path) -> bool:
    try:
        return os.path.lexists(name)
    except ValueError:
        return True  # it is no name, as `_checked` says


def _named(path: Path | None, field: str, kind: Kind, remedy: str = REMEDY) -> list[Named]:
    """Return a list with what is named, if anything is."""
    return [] if path is None else [Named(path, field, kind, remedy)]


def _checked(named: Named) -> Path:
    """Make sure that a path leads to what can be read."""
    wrong = _what_is_wrong(named.path, named.kind)
    if wrong is not None:
        raise InputError(wrong, file=named.path, field=named.field, remedy=named.remedy)
    return named.path


def _what_is_wrong(path: Path, kind: Kind) -> str | None:
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        return "no such file"
    except (OSError, ValueError) as error:
        return f"cannot be read ({getattr(error, 'strerror', None) or error})"
    is_folder = stat.S_ISDIR(mode)
    if not is_folder and not stat.S_ISREG(mode):
        return "is neither a file nor a folder"
    if kind == "file" and is_folder:
        return "is a folder, not a file"
    if kind == "folder" and not is_folder:
        return "is a file, not a folder"
    if not os.access(path, os.R_OK | (os.X_OK if is_folder else 0)):
        return "cannot be read (Permission denied)"
    return None
