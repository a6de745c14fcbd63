"""What a run of the program may do, and what it did: judged from its exit, its words and its files alone.

Clean is either a refusal, or a result. A refusal has exit status 2 and one line that names the file; nothing is
written. A result is whole, finite, and records the checksum of what was read; where the content was illegal (see
`Damage`), it is the undamaged file's result, or the run has said a word.
"""

from __future__ import annotations

import hashlib
import json
import math
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from astropy.io import fits

from tests.faults.damage import Damage

CLEAN, TRACEBACKS, HANGS, WRONG, LOST = "clean", "tracebacks", "hangs", "wrong_in_silence", "lost"
KINDS = (CLEAN, TRACEBACKS, HANGS, WRONG, LOST)
MARK, COMPLAINT, WARNING = "hydrabeam: ", "hydrabeam: error: ", "hydrabeam: warning: "
READABLE = 2000
"""Characters of a message that is still one line to a reader."""
SAME = 1e-6
"""Relative difference of two runs' numbers that is rounding: a copy in another format keeps single precision."""

GROWING = ("manifest.json", "table.lock")
"""What may change in an input: a report adds its files to a manifest, casacore makes locks in a measurement set."""

Answer = dict[str, Any]


@dataclass(frozen=True)
class Outcome:
    """What a run left.

    Attributes
    ----------
    status : int
        Exit status; 1 after an exception that nothing caught.
    out, err : str
        What it printed.
    """

    status: int
    out: str
    err: str

    @property
    def lines(self) -> list[str]:
        """Lines of its complaints and progress."""
        return self.err.splitlines()

    @property
    def warnings(self) -> list[str]:
        """What it warned of."""
        return [line for line in self.lines if line.startswith(WARNING)]


def unclear(outcome: Outcome, names: tuple[str, ...]) -> str | None:
    """Say what is wrong with the way a run ended and what it said, if anything; one of ``names`` is to be in it."""
    if outcome.status not in (0, 2):
        return f"exit status {outcome.status}: {outcome.lines[-1] if outcome.lines else ''}"
    if any(not line.startswith(MARK) for line in outcome.lines):
        return "lines that are not its own: " + next(line for line in outcome.lines if not line.startswith(MARK))
    noise = [line for line in outcome.lines if "encountered in" in line]
    if noise:
        return f"numpy's own warning: {noise[0]}"
    complaints = [line for line in outcome.lines if line.startswith(COMPLAINT)]
    if len(complaints) != (outcome.status == 2):
        return f"{len(complaints)} complaints, exit status {outcome.status}"
    if not complaints:
        return None
    if outcome.lines[-1] != complaints[0] or outcome.out:
        return "words after the complaint"
    if not any(name in complaints[0] for name in names):
        return f"names no file: {complaints[0]}"
    if len(complaints[0]) > READABLE:
        return f"{len(complaints[0])} characters: {complaints[0][:100]}"
    return None


def nonfinite(folder: Path) -> str | None:
    """Name a number in a result that is not finite, if there is one."""
    for path in sorted(folder.rglob("*")):
        if path.suffix in (".h5", ".uvh5"):
            found = _nonfinite_hdf5(path)
        elif path.suffix == ".beamfits":
            with fits.open(path) as file:
                found = None if np.isfinite(file[0].data).all() else "the data"
        elif path.suffix == ".json":
            found = nonfinite_in(json.loads(path.read_text()))
        elif path.suffix == ".toml":
            found = nonfinite_in(tomllib.loads(path.read_text()))
        else:
            continue
        if found:
            return f"{found} in {path.name} is not finite"
    return None


def _nonfinite_hdf5(path: Path) -> str | None:
    found: list[str] = []

    def visit(name: str, item: Any) -> None:
        numbers = isinstance(item, h5py.Dataset) and item.shape is not None and item.dtype.kind in "fc"
        if numbers and not np.isfinite(item[()]).all():
            found.append(name)

    with h5py.File(path) as file:
        file.visititems(visit)
    return found[0] if found else None


def nonfinite_in(value: Any, way: str = "") -> str | None:
    """Name a number in nested lists and tables that is not finite."""
    if isinstance(value, float):
        return None if math.isfinite(value) else way
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return next((found for key, inner in items if (found := nonfinite_in(inner, f"{way}/{key}"))), None)


def answer_of(command: str, folder: Path, outcome: Outcome) -> Answer:
    """Return the numbers by which two results are compared; of commands without a result folder, the words."""
    if command in ("init", "report"):
        return {"out": outcome.out}
    if command == "predict":
        told = json.loads((folder / "prediction.json").read_text())
        return {name: np.array(value) for name, value in told.items() if isinstance(value, float)}
    of_data = {"simulate": "data.uvh5", "correct": "corrected.uvh5"}
    path, names = folder / of_data.get(command, "posterior.h5"), ("Data/visdata",) if command in of_data else ()
    with h5py.File(path) as file:
        groups = sorted(name for name in file if name.startswith("channel"))
        names = names or tuple(f"{group}/{name}" for group in groups for name in ("mean", "covariance"))
        return {name: np.asarray(file[name][()]) for name in names}


def same(one: Answer, other: Answer) -> bool:
    """Whether two answers agree but for rounding."""
    if one.keys() != other.keys():
        return False
    for name, value in one.items():
        if isinstance(value, str):
            if value != other[name]:
                return False
        elif value.shape != other[name].shape or np.abs(value - other[name]).max() > SAME * np.abs(value).max():
            return False
    return True


def misrecorded(folder: Path, damaged: Path) -> str | None:
    """Say whether the result's provenance has another checksum of the damaged file than the file."""
    record = json.loads((folder / "provenance.json").read_text())
    said = record.get("sha256", {}).get(str(damaged))
    if said is None or not damaged.is_file() or said == hashlib.sha256(damaged.read_bytes()).hexdigest():
        return None
    return f"the checksum of {damaged.name} is not the file's"


def silent(damage: Damage, outcome: Outcome, answer: Answer, good: Answer, warned_before: int) -> str | None:
    """Say whether illegal content has changed a result without a word."""
    if not damage.illegal or len(outcome.warnings) > warned_before or same(good, answer):
        return None
    return "illegal content changed the result without a word"


def state(folder: Path) -> dict[str, tuple[int, str]]:
    """Return what a folder holds, so that a change shows, but for what is `GROWING`."""
    held = {}
    for path in sorted(folder.rglob("*")):
        if path.name in GROWING:
            continue
        if path.is_symlink() or not path.is_file():
            held[str(path.relative_to(folder))] = (-1, "")
        else:
            content = path.read_bytes()
            held[str(path.relative_to(folder))] = (len(content), hashlib.sha256(content).hexdigest())
    return held


def lost(before: dict[str, Any], after: dict[str, Any], new: tuple[str, ...]) -> str | None:
    """Say what is gone, changed or left behind; paths that begin with one of ``new`` may appear."""
    gone = [name for name in before if name not in after]
    changed = [name for name in before if name in after and before[name] != after[name]]
    left = [name for name in after if name not in before and not name.startswith(new)]
    for what, names in (("gone", gone), ("changed", changed), ("left behind", left)):
        if names:
            return f"{what}: {', '.join(names[:5])}"
    return None
