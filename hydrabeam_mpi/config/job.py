"""The job file as a whole: reading, validating, and finding the files that it names."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from hydrabeam_mpi.config.mistakes import as_input_error
from hydrabeam_mpi.config.sections import (
    BUILT_IN_BEAMS,
    Basis,
    Beam,
    Data,
    Holdout,
    Noise,
    Output,
    Prior,
    Section,
    Sky,
    Solver,
    key,
)
from hydrabeam_mpi.errors import InputError

PATH_KEYS = (
    ("data", "files"),
    ("data", "gains"),
    ("data", "simulate", "array", "file"),
    ("noise", "file"),
    ("sky", "file"),
    ("sky", "diffuse"),
    ("beam", "source"),
    ("prior", "file"),
)


class Job(Section):
    """A whole job file."""

    name: str = key("job", "for titles")
    seed: int = key(0, "of every random number", ge=0)
    data: Data
    noise: Noise = Noise()
    holdout: Holdout = Holdout()
    sky: Sky = Sky()
    beam: Beam = Beam()
    basis: Basis = Basis()
    prior: Prior = Prior()
    solver: Solver = Solver()
    output: Output = Output()


def load_job(path: Path) -> Job:
    """Read and validate a job file; file names in it are relative to its folder.

    Raises
    ------
    InputError
        If it cannot be read, is not TOML, or a key is unknown, missing or of the wrong type or unit.
    """
    try:
        with path.open("rb") as file:
            table = tomllib.load(file)
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", file=path, remedy="check the path") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"is not a TOML file ({error})", file=path, remedy="mend that line") from error
    resolved = _with_absolute_paths(table, path.resolve().parent)
    try:
        # As JSON: lists and texts become tuples and paths, and no other type is taken for another.
        return Job.model_validate_json(json.dumps(resolved, default=str))
    except ValidationError as error:
        raise as_input_error(error, Job, path) from error


def named_files(job: Job) -> list[Path]:
    """List the files and folders that a job names, wildcards as they are."""
    named: list[Path] = []
    for *parents, name in PATH_KEYS:
        section: Any = job
        for parent in parents:
            section = getattr(section, parent, None)
        value = getattr(section, name, None) or ()
        named += map(Path, value if isinstance(value, tuple) else [value])
    return [path for path in named if str(path) not in BUILT_IN_BEAMS]


def _with_absolute_paths(table: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Resolve the file names of a job against the folder of the job file; named beams stay what they are."""

    def resolve(value: Any) -> Any:
        if isinstance(value, list):
            return [resolve(item) for item in value]
        return str(folder / Path(value).expanduser()) if isinstance(value, str) else value

    for *parents, name in PATH_KEYS:
        section: Any = table
        for parent in parents:
            section = section.get(parent) if isinstance(section, dict) else None
        is_beam = name == "source" and isinstance(section, dict) and section.get(name) in BUILT_IN_BEAMS
        if isinstance(section, dict) and name in section and not is_beam:
            section[name] = resolve(section[name])
    return table
