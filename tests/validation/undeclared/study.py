"""Many draws: which, one of them from data to score, and what all of them come to."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tests.validation.undeclared.cases import CONVENTIONS, EFFECTS, PAIRS, UNKNOWN
from tests.validation.undeclared.generate import GIVEN, SEALED, generate
from tests.validation.undeclared.score import class_of, score

REPOSITORY = Path(__file__).resolve().parents[3]
A_PASS = {"null": 3, "pair": 5, "unknown": 4, "convention": 2}
"""Draws of each sort beside one of every known effect."""
LONGEST_S = 900


def schedule(n: int, seed: int) -> list[tuple[str, int]]:
    """Return ``n`` draws as (case, seed): pass after pass over all effects, with some of each other sort."""
    others = {
        "null": ["null"],
        "pair": ["+".join(pair) for pair in PAIRS],
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


def run_draw(case: str, seed: int, keep: Path | None = None) -> dict[str, Any]:
    """Make data, run the loop on them in a process of its own, and score what it wrote.

    Parameters
    ----------
    case : str
    seed : int
    keep : Path, optional
        Where data, result and answer are to stay.
    """
    with tempfile.TemporaryDirectory() as own:
        folder = Path(own) if keep is None else keep
        if keep is not None:
            shutil.rmtree(folder, ignore_errors=True)
        started = time.perf_counter()
        generate(seed, folder, case)
        made = time.perf_counter()
        answer = json.loads((folder / SEALED / "answer.json").read_text())
        out = folder / "result"
        command = [sys.executable, "-m", "hydrabeam_mpi", "loop", str(folder / GIVEN / "job.toml"), "-o", str(out)]
        environment = os.environ | {"OMP_NUM_THREADS": "1", "PYTHONPATH": str(REPOSITORY)}
        failed = {"case": case, "seed": seed, "class": class_of(case)}
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


def _fraction(values: Sequence[bool]) -> float | None:
    return round(float(np.mean(values)), 4) if len(values) else None


def summarise(draws: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return the fractions that count; None where there was no such draw. A draw that failed is wrong in all."""
    failed = [one for one in draws if "failed" in one]
    fine = [one for one in draws if "failed" not in one]
    singles = [one for one in fine if one["class"] in ("single", "convention") and one["detectable"]]
    right = [one for one in singles if one["named"] in ("right", "equivalent", "indistinguishable")]
    broken = {sort: [False for one in failed if one["class"] == sort] for sort in (*A_PASS, "single")}
    names = broken["single"] + broken["convention"]
    compared = [one["parameters_hold"] for one in right if one.get("parameters_hold") is not None]
    z = np.array([z for one in right for z in one.get("z", [])])
    pairs = [one for one in fine if one["class"] == "pair" and one["detectable"]]
    unknown = [one for one in fine if one["class"] == "unknown" and one["detectable"]]
    null = [one for one in fine if one["class"] == "null"]
    faint = [one for one in fine if one["class"] == "single" and not one["detectable"]]
    return {
        "named_right": _fraction([one in right for one in singles] + names),
        "named_right_alone": _fraction([one["named"] == "right" for one in singles] + names),
        "parameters_within_3_sigma": _fraction(compared),
        "parameters_within_3_sigma_each": _fraction((np.abs(z) <= 3).tolist()),
        "heldout_back": _fraction([one["heldout_holds"] for one in right if one["class"] == "single"]),
        "two_at_once": _fraction([one["both"] for one in pairs] + broken["pair"]),
        "two_at_once_or_indistinguishable": _fraction(
            [one["both_or_indistinguishable"] for one in pairs] + broken["pair"]
        ),
        "unknown_kept_unknown": _fraction(
            [one["kept_unknown"] and one["where_right"] for one in unknown] + broken["unknown"]
        ),
        "unknown_unexplained": _fraction([one["kept_unknown"] for one in unknown] + broken["unknown"]),
        "false_alarms": _fraction([one["false_alarm"] for one in null] + [not one for one in broken["null"]]),
        "faint_misnamed": _fraction([one["named"] == "wrong" for one in faint]),
        "failed": len(failed),
        "draws": len(draws),
    }


KEYS = (
    "named_right",
    "parameters_within_3_sigma",
    "two_at_once",
    "unknown_kept_unknown",
    "false_alarms",
    "draws",
)
"""What the last line tells."""


def table(draws: Sequence[dict[str, Any]]) -> str:
    """Return one line a case: draws, detectable ones, and how these went."""
    head = f"{'case':40s} {'draws':>5s} {'seen':>4s} {'right':>5s} {'3 sig':>5s} {'chi2':>5s}  wrong: first name"
    lines = [head]
    for case in sorted({one["case"] for one in draws}, key=lambda name: (class_of(name), name)):
        mine = [one for one in draws if one["case"] == case]
        fine = [one for one in mine if "failed" not in one]
        seen = [one for one in fine if one["detectable"]]
        good = [one for one in seen if _good(one)]
        holds = [one["parameters_hold"] for one in good if one.get("parameters_hold") is not None]
        chi2 = [one["heldout_holds"] for one in seen]
        wrong = [f"{one['first']} ({one['verdict']}, seed {one['seed']})" for one in seen if not _good(one)]
        wrong += [f"FAILED (seed {one['seed']})" for one in mine if "failed" in one]
        lines.append(
            f"{case:40s} {len(mine):5d} {len(seen):4d} {len(good):5d} {sum(holds):2d}/{len(holds):<2d} "
            f"{sum(chi2):2d}/{len(chi2):<2d}  {', '.join(wrong)}"
        )
    return "\n".join(lines)


def _good(one: dict[str, Any]) -> bool:
    """Tell whether a draw went as it should."""
    if one["class"] == "null":
        return not one["false_alarm"]
    if one["class"] == "unknown":
        return bool(one["kept_unknown"] and one["where_right"])
    if one["class"] == "pair":
        return bool(one["both"])
    return one["named"] in ("right", "equivalent", "indistinguishable")


def confusion(draws: Sequence[dict[str, Any]]) -> tuple[list[str], list[str], np.ndarray]:
    """Count what is said first of what is so, over detectable draws without pairs: rows, columns and counts."""
    fine = [one for one in draws if "failed" not in one and one["class"] != "pair" and one["detectable"]]
    rows = [*EFFECTS, *CONVENTIONS, *UNKNOWN, "null"]
    columns = [*EFFECTS, *sorted({one["first"] for one in fine} - {*EFFECTS, "none"}), "unexplained", "none"]
    counts = np.zeros((len(rows), len(columns)), dtype=int)
    for one in fine:
        unexplained = (one["class"] == "unknown" and one["kept_unknown"]) or (
            one["first"] == "none" and one["verdict"] == "unexplained"
        )
        counts[rows.index(one["case"]), columns.index("unexplained" if unexplained else one["first"])] += 1
    return rows, columns, counts
