"""One case: a seed and a number give a file, what is done to it, and the run on it."""

from __future__ import annotations

import os
import pickle
import shutil
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import cache
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from hydrabeam_mpi.cli import main
from tests.faults.damage import BYTES, Damage, Mutator, Rng, pick
from tests.faults.damage_fits import FITS
from tests.faults.damage_hdf5 import HDF5
from tests.faults.damage_job import TOML
from tests.faults.damage_text import JSON, TEXT
from tests.faults.oracle import (
    CLEAN,
    LOST,
    TRACEBACKS,
    WRONG,
    Answer,
    Outcome,
    answer_of,
    lost,
    misrecorded,
    nonfinite,
    silent,
    state,
    unclear,
)
from tests.faults.samples import TARGETS, Target

FAMILIES: dict[str, tuple[Mutator, ...]] = {
    "bytes": BYTES, "hdf5": HDF5, "fits": FITS, "text": TEXT, "toml": TOML, "json": JSON,
}  # fmt: skip
ANSWERS = "answers.pickle"
_QUICK = [(target.title, family) for target in TARGETS if target.is_quick for family in target.damage]
ALL_QUICK: set[object] = {*_QUICK, *(mutate for _, family in _QUICK for mutate in FAMILIES[family])}
"""What quick cases can be: any family of mutations on any file, and any mutation."""
Answers = dict[str, tuple[Answer, int]]
OVERWRITES = 0.1
"""Fraction of runs in whose place an earlier result stands."""


@dataclass(frozen=True)
class Verdict:
    """What came out of a case.

    Attributes
    ----------
    index : int
        Of the case.
    kind : str
        One of `hydrabeam_mpi`'s ways to end, see `tests.faults.oracle.KINDS`.
    target, damage : str
    words : str
        What is wrong, or how it ended.
    seconds : float
    """

    index: int
    kind: str
    target: str
    damage: str
    words: str
    seconds: float


def drawn(seed: int, index: int) -> tuple[Target, Rng]:
    """Draw the file of a case."""
    rng = np.random.default_rng([seed, index])
    weights = np.array([target.weight for target in TARGETS])
    return TARGETS[int(rng.choice(len(TARGETS), p=weights / weights.sum()))], rng


def covering(seed: int) -> Iterator[int]:
    """Yield the first quick cases that suffer something new, up to `ALL_QUICK`."""
    left, indices = set(ALL_QUICK), count()
    while left:
        target, rng = drawn(seed, index := next(indices))
        family, number = _drawn_mutation(target, rng)
        new = {(target.title, family), FAMILIES[family][number]} if target.is_quick else set()
        if new & left:
            left -= new
            yield index


def run_case(
    samples: Path, seed: int, index: int, show: bool = False, begun: Callable[[str, str], None] = lambda *_: None
) -> Verdict:
    """Damage a copy of a good file, run the program on it, and judge; ``begun`` hears of file and damage first."""
    target, rng = drawn(seed, index)
    started = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="fuzz") as own:
        folder = Path(own).resolve()
        arguments = set_up(samples, target, folder)
        damage = _damaged(target, folder / target.name / target.inside, rng)
        begun(target.title, damage.words)
        earlier = target.command not in ("init", "report") and rng.random() < OVERWRITES
        if earlier:
            shutil.copytree(samples / "mock", folder / "out")
            arguments.append("--overwrite")
        before = state(folder)
        outcome = execute(arguments, folder)
        if show:
            print(f"{outcome.out}{outcome.err}", end="")
        kind, words = _judge(samples, target, folder, damage, outcome, before)
    return Verdict(index, kind, target.title, damage.words, words, round(time.monotonic() - started, 2))


def _drawn_mutation(target: Target, rng: Rng) -> tuple[str, int]:
    """Draw the family and the number in it."""
    family = pick(rng, target.damage)
    return family, int(rng.integers(len(FAMILIES[family])))


def set_up(samples: Path, target: Target, folder: Path) -> list[str]:
    """Copy the good file and write its job; return the command line."""
    source, file = samples / target.name, folder / target.name
    if source.is_dir():
        shutil.copytree(source, file)
    else:
        shutil.copy(source, file)
    if target.command in ("init", "report"):
        return [target.command, str(file)]
    job = file
    if target.job is not None:
        job = folder / "job.toml"
        job.write_text(tomli_w.dumps(target.job(samples, file)))
    result = file if target.name == "both" else samples / "both"
    applied = [str(result)] if target.command in ("predict", "correct") else []
    return [target.command, *applied, str(job), "-o", str(folder / "out")]


def _damaged(target: Target, path: Path, rng: Rng) -> Damage:
    family, number = _drawn_mutation(target, rng)
    mutate = FAMILIES[family][number]
    if path.is_dir():
        path = pick(rng, sorted(inner for inner in path.rglob("*") if inner.is_file()))
    damage = mutate(path, rng)
    return Damage(f"{path.name}: {damage.words}", damage.illegal)


def execute(arguments: list[str], folder: Path) -> Outcome:
    """Run a command in this process, and return what it wrote to the streams of the process itself."""
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err:
        with _streams(out, err):
            try:
                status = main(arguments)
            except SystemExit as end:
                status = int(end.code or 0) if isinstance(end.code, int | None) else 1
            except Exception:
                traceback.print_exc()
                status = 1
        texts = []
        for stream in (out, err):
            stream.seek(0)
            texts.append(stream.read())
    return Outcome(status, *texts)


@contextmanager
def _streams(out: Any, err: Any) -> Iterator[None]:
    """Send both streams into files, what libraries written in C say included."""
    kept = [os.dup(number) for number in (1, 2)]
    sys.stdout.flush()
    sys.stderr.flush()
    os.dup2(out.fileno(), 1)
    os.dup2(err.fileno(), 2)
    try:
        yield
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        for number, old in zip((1, 2), kept, strict=True):
            os.dup2(old, number)
            os.close(old)


def make_answers(samples: Path, quick: bool) -> None:
    """Run every command on the undamaged files, all of which are to be taken, and keep the results beside them.

    Where ``quick`` is set, only those of quick targets.
    """
    answers: Answers = {}
    for target in TARGETS:
        if quick and not target.is_quick:
            continue
        with tempfile.TemporaryDirectory(prefix="fuzz") as own:
            folder = Path(own).resolve()
            outcome = execute(set_up(samples, target, folder), folder)
            assert outcome.status == 0, f"{target.title}: {outcome.err}"
            answer = answer_of(target.command, folder / "out", outcome)
            answers[target.title] = _without(answer, folder), len(outcome.warnings)
    (samples / ANSWERS).write_bytes(pickle.dumps(answers))


@cache
def good_answers(samples: Path) -> Answers:
    """Return the results of the undamaged files, and how many warnings there were."""
    answers: Answers = pickle.loads((samples / ANSWERS).read_bytes())
    return answers


def _without(answer: Answer, folder: Path) -> Answer:
    """Take the folder's own name out of words."""
    return {name: value.replace(str(folder), "") if isinstance(value, str) else value for name, value in answer.items()}


def _judge(
    samples: Path, target: Target, folder: Path, damage: Damage, outcome: Outcome, before: dict[str, Any]
) -> tuple[str, str]:
    """Return the kind of ending and words."""
    out = folder / "out"
    new = (f"{target.name}/figures", f"{target.name}/report.html") if target.command == "report" else ("out",)
    succeeded = outcome.status == 0
    if succeeded and new == ("out",):
        before = {name: held for name, held in before.items() if not name.startswith("out")}
    words = lost(before, state(folder), new if succeeded else ())
    if words:
        return LOST, words
    # Of a job whose text is changed a path may be wrong, which the job's key tells; "~" is one that exists.
    keys = ("[data]", "[sky]", "[noise]", os.path.expanduser("~")) if target.name.endswith(".toml") else ()
    names = (target.name, "job.toml", "-o", *keys)
    words = unclear(outcome, names)
    if words:
        return TRACEBACKS, words
    if not succeeded:
        return CLEAN, outcome.lines[-1]
    if target.command == "report":
        return CLEAN, "reported"
    if target.command == "init":
        answer = _without(answer_of("init", out, outcome), folder)
    else:
        words = nonfinite(out) or misrecorded(out, folder / target.name)
        if words:
            return WRONG, words
        answer = answer_of(target.command, out, outcome)
    words = silent(damage, outcome, answer, *good_answers(samples)[target.title])
    return (WRONG, words) if words else (CLEAN, "succeeded")


def as_table(verdict: Verdict) -> dict[str, Any]:
    """Return a verdict as a table for JSON."""
    return asdict(verdict)
