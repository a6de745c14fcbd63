"""Many draws: which, and one of them from data to score."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from tests.validation.undeclared.cases import (
    CONVENTIONS,
    EFFECTS,
    FAULTS,
    IN_TIME,
    NULLS,
    PAIRS,
    STRONG,
    TRIPLES,
    UNKNOWN,
)
from tests.validation.undeclared.generate import GIVEN, SEALED, generate
from tests.validation.undeclared.score import class_of, score

REPOSITORY = Path(__file__).resolve().parents[3]
A_PASS = {"null": 3, "strong": 3, "in time": 4, "fault": 2, "pair": 5, "triple": 2, "unknown": 5, "convention": 2}
"""Draws of each sort beside one of every known effect."""
LONGEST_S = 900


def schedule(n: int, seed: int) -> list[tuple[str, int]]:
    """Return ``n`` draws as (case, seed): pass after pass over all effects, with some of each other sort."""
    others = {
        "null": list(NULLS),
        "strong": list(STRONG),
        "in time": list(IN_TIME),
        "fault": list(FAULTS),
        "pair": ["+".join(pair) for pair in PAIRS],
        "triple": ["+".join(triple) for triple in TRIPLES],
        "unknown": list(UNKNOWN),
        "convention": list(CONVENTIONS),
    }
    used = dict.fromkeys(others, 0)
    draws: list[tuple[str, int]] = []
    while len(draws) < n:
        names = list(EFFECTS)
        for sort, count in A_PASS.items():
            for _ in range(count):
                names.append(others[sort][used[sort] % len(others[sort])])
                used[sort] += 1
        draws += [(name, seed + len(draws) + place) for place, name in enumerate(names)]
    return draws[:n]


def run_draw(case: str, seed: int, keep: Path | None = None, basis: str = "study") -> dict[str, Any]:
    """Make data, run the loop on them in a process of its own, and score what it wrote.

    Parameters
    ----------
    case : str
    seed : int
    keep : Path, optional
        Where data, result and answer are to stay.
    basis : str, optional
        One of `basis.BASES`, which the job is to have.
    """
    with tempfile.TemporaryDirectory() as own:
        folder = Path(own) if keep is None else keep
        if keep is not None:
            shutil.rmtree(folder, ignore_errors=True)
        started = time.perf_counter()
        generate(seed, folder, case, basis)
        made = time.perf_counter()
        answer = json.loads((folder / SEALED / "answer.json").read_text())
        out = folder / "result"
        command = [sys.executable, "-m", "hydrabeam_mpi", "loop", str(folder / GIVEN / "job.toml"), "-o", str(out)]
        environment = os.environ | {"OMP_NUM_THREADS": "1", "PYTHONPATH": str(REPOSITORY)}
        failed = {"case": case, "seed": seed, "class": class_of(case), "basis": basis}
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, env=environment, timeout=LONGEST_S, cwd=folder, check=False
            )
        except subprocess.TimeoutExpired:
            return failed | {"failed": f"took more than {LONGEST_S} s"}
        if done.returncode:
            lines = (done.stderr.strip() or done.stdout.strip()).splitlines()
            return failed | {"failed": "\n".join(lines[-15:])}
        told = score(answer, json.loads((out / "loop.json").read_text()))
        seconds = {"generate": made - started, "loop": time.perf_counter() - made}
        return told | {"seconds": seconds}
