"""What all draws of a study come to."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from tests.validation.undeclared.cases import CONVENTIONS, EFFECTS, FAULTS, IN_TIME, NULLS, STRONG, UNKNOWN
from tests.validation.undeclared.score import class_of

ALONE = ("single", "convention", "fault")
"""Classes of draws with one thing wrong, which has a name."""
RIGHT = ("right", "equivalent", "indistinguishable")

CLASSES = ("null", *ALONE, "unknown", "pair", "triple")

KEYS = (
    "named_right",
    "named_right_alone",
    "law_named",
    "clean",
    "parameters_within_3_sigma",
    "two_at_once",
    "three_at_once",
    "unknown_kept_unknown",
    "revoked",
    "rms_at_noise",
    "false_alarms",
    "draws",
)
"""What the last line tells."""


def _fraction(values: Sequence[bool]) -> float | None:
    return round(float(np.mean(values)), 4) if len(values) else None


def summarise(draws: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return the fractions that count; None where there was no such draw. A draw that failed is wrong in all."""
    failed = [one for one in draws if "failed" in one]
    fine = [one for one in draws if "failed" not in one]
    broken = {sort: [False for one in failed if one["class"] == sort] for sort in CLASSES}
    seen = {sort: [one for one in fine if one["class"] == sort and one["detectable"]] for sort in CLASSES}
    singles = [one for sort in ALONE for one in seen[sort]]
    right = [one for one in singles if one["named"] in RIGHT]
    names = [False for sort in ALONE for _ in broken[sort]]
    compared = [one["parameters_hold"] for one in right if one.get("parameters_hold") is not None]
    z = np.array([z for one in right for z in one.get("z", [])])
    at_noise = [one["at_noise"] for one in fine if one["verdict"] == "explained" and one["at_noise"] is not None]
    revoked = [name for one in fine for name in one["revoked"]]
    pairs, unknown, null = seen["pair"], seen["unknown"], seen["null"]
    faint = [one for one in fine if one["class"] == "single" and not one["detectable"]]
    return {
        "named_right": _fraction([one in right for one in singles] + names),
        "named_right_alone": _fraction([one["named"] == "right" for one in singles] + names),
        "law_named": _fraction([one["law_named"] for one in singles if one.get("law_named") is not None]),
        "clean": _fraction([not one["not_so"] for one in fine] + [False] * len(failed)),
        "parameters_within_3_sigma": _fraction(compared),
        "parameters_within_3_sigma_each": _fraction((np.abs(z) <= 3).tolist()),
        "heldout_back": _fraction([one["heldout_holds"] for one in right if one["class"] == "single"]),
        "two_at_once": _fraction([one["both"] for one in pairs] + broken["pair"]),
        "two_at_once_or_indistinguishable": _fraction(
            [one["both_or_indistinguishable"] for one in pairs] + broken["pair"]
        ),
        "three_at_once": _fraction([one["both"] for one in seen["triple"]] + broken["triple"]),
        "unknown_kept_unknown": _fraction(
            [one["kept_unknown"] and one["where_right"] for one in unknown] + broken["unknown"]
        ),
        "unknown_unexplained": _fraction([one["kept_unknown"] for one in unknown] + broken["unknown"]),
        "false_alarms": _fraction([one["false_alarm"] for one in null] + [not one for one in broken["null"]]),
        "revoked": len(revoked),
        "revoked_rightly": _fraction([not was_so for one in fine for was_so in one["revoked_so"]]),
        "rms_at_noise": _fraction(at_noise),
        "faint_misnamed": _fraction([one["named"] == "wrong" for one in faint]),
        "failed": len(failed),
        "draws": len(draws),
    }


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
    if one["class"] in ("pair", "triple"):
        return bool(one["both"])
    return one["named"] in RIGHT


def confusion(draws: Sequence[dict[str, Any]]) -> tuple[list[str], list[str], np.ndarray]:
    """Count what is said first of what is so, over detectable draws of one effect: rows, columns and counts."""
    fine = [
        one for one in draws if "failed" not in one and one["class"] not in ("pair", "triple") and one["detectable"]
    ]
    rows = [*EFFECTS, *STRONG, *IN_TIME, *FAULTS, *CONVENTIONS, *UNKNOWN, *NULLS]
    columns = [*EFFECTS, *sorted({one["first"] for one in fine} - {*EFFECTS, "none"}), "unexplained", "none"]
    counts = np.zeros((len(rows), len(columns)), dtype=int)
    for one in fine:
        unexplained = (one["class"] == "unknown" and one["kept_unknown"]) or (
            one["first"] == "none" and one["verdict"] == "unexplained"
        )
        counts[rows.index(one["case"]), columns.index("unexplained" if unexplained else one["first"])] += 1
    return rows, columns, counts
