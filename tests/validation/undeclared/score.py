"""How a loop's record compares with what was really wrong."""

from __future__ import annotations

from typing import Any

import numpy as np

from tests.validation.undeclared.cases import CONVENTIONS, EFFECTS, UNKNOWN
from tests.validation.undeclared.match import Comparison, compare

LARGEST_CHI2 = 1.1

EQUIVALENT = {
    ("auto_coupling", "cross_coupling"): "an autocorrelation that hardly changes with time is a constant",
    ("cross_coupling", "auto_coupling"): "an autocorrelation that hardly changes with time is a constant",
    ("convention: times in TAI", "timestamp"): "a clock that is wrong by a number of seconds is a timestamp offset",
}
"""(what is so, what may be said instead): physically the same, so that either name is right."""

CONVENTION_NAMES = {
    "conjugated": "conjugated",
    "halved": "factor 1/2",
    "doubled": "factor 2",
    "north and east exchanged": "north and east swapped",
    "times in TAI": "times in TAI",
    "antennas sorted by name": "positions sorted by name, antennas not",
}
"""What the loop calls the mistakes of `conventions`."""


def score(answer: dict[str, Any], loop: dict[str, Any]) -> dict[str, Any]:
    """Score one draw.

    Parameters
    ----------
    answer : dict
        ``answer.json``.
    loop : dict
        ``loop.json``.

    Returns
    -------
    dict
        "class" ("null", "single", "pair", "unknown" or "convention"); "first", what the loop names first, or "none";
        "named": "right", "equivalent" (`EQUIVALENT`), "indistinguishable" (the loop says that it may as well be the
        right one), "wrong" or "none"; "detectable"; "z", deviations of parameters in sigma; "parameters_hold";
        "heldout_holds"; for pairs "both", and "both_or_indistinguishable", where the loop says of a name that it may
        as well be the right one; for unknown effects "kept_unknown" and "where_right"; for null draws
        "false_alarm".
    """
    effects = answer["effects"]
    found = [one["effect"] for one in loop["rounds"]]
    convention = loop.get("conventions", {}).get("found")
    first = f"convention: {convention}" if convention else (found[0] if found else "none")
    told: dict[str, Any] = {
        "case": answer["case"],
        "seed": answer["seed"],
        "class": class_of(answer["case"]),
        "strength": [effect["strength"] for effect in effects],
        "chi2_left": [effect["chi2_left"] for effect in effects],
        "detectable": all(effect["detectable"] or _is_mistake(effect) for effect in effects),
        "first": first,
        "found": found,
        "verdict": loop["verdict"],
        "error_before": loop["error_before"],
        "error_after": loop["error_after"],
        "heldout_holds": bool(loop["error_after"] <= LARGEST_CHI2),
    }
    if not effects:
        return told | {"false_alarm": bool(found or convention or loop["verdict"] != "consistent")}
    if told["class"] == "unknown":
        where_right = is_where(effects[0]["where"], loop.get("where"), answer)
        kept = loop["verdict"] == "unexplained"
        return told | {"kept_unknown": kept, "where_right": where_right}
    if told["class"] == "convention":
        return told | {"named": _named_convention(effects[0]["kind"], first, loop["verdict"])}
    if told["class"] == "pair":
        wanted = {effect["kind"] for effect in effects}
        told["both"] = all(any(_same(kind, name) for name in found) for kind in wanted)
        allowed = {*found, *(other for one in loop["rounds"] for other in one["indistinguishable_from"])}
        told["both_or_indistinguishable"] = all(any(_same(kind, name) for name in allowed) for kind in wanted)
    told["named"] = _named(effects, loop["rounds"])
    comparisons = _comparisons(effects, loop["rounds"], answer)
    told["z"] = [float(z) for one in comparisons for z in one.z]
    holds = [one.holds for one in comparisons if one.holds is not None]
    told["parameters_hold"] = all(holds) if holds else None
    return told


def _is_mistake(effect: dict[str, Any]) -> bool:
    """Tell whether an effect is a convention that is not kept; numbers may be in the order of their names already."""
    return effect["kind"] in CONVENTIONS and effect["about"].get("antennas that moved") != 0


def class_of(case: str) -> str:
    """Return what sort of draw a case is."""
    if case == "null":
        return "null"
    if "+" in case:
        return "pair"
    return "unknown" if case in UNKNOWN else "convention" if case in CONVENTIONS else "single"


def _same(kind: str, name: str) -> bool:
    return kind == name or (kind, name) in EQUIVALENT


def _named(effects: list[dict[str, Any]], rounds: list[dict[str, Any]]) -> str:
    """Judge the first name."""
    if not rounds:
        return "none"
    kinds = [effect["kind"] for effect in effects]
    first = rounds[0]
    if first["effect"] in kinds:
        return "right"
    if any(_same(kind, first["effect"]) for kind in kinds):
        return "equivalent"
    return "indistinguishable" if set(kinds) & set(first["indistinguishable_from"]) else "wrong"


def _named_convention(kind: str, first: str, verdict: str) -> str:
    """Judge what is named; what reads the verdict alone must not go on with data that keep another convention."""
    wanted = CONVENTION_NAMES[kind.removeprefix("convention: ")]
    if first == f"convention: {wanted}":
        return "right" if verdict == "convention" else "wrong"
    if (kind, first) in EQUIVALENT:
        return "equivalent"
    return "none" if first == "none" else "wrong"


def _comparisons(
    effects: list[dict[str, Any]], rounds: list[dict[str, Any]], answer: dict[str, Any]
) -> list[Comparison]:
    """Compare each effect with the first round that names it."""
    out = []
    for effect in effects:
        named = next((one for one in rounds if one["effect"] == effect["kind"]), None)
        if named is not None and effect["kind"] in EFFECTS:
            out.append(compare(effect, named, answer))
    return out


def is_where(truth: dict[str, Any], told: dict[str, Any] | None, answer: dict[str, Any]) -> bool:
    """Judge where the loop says that the residual lives.

    What carries the effect must be first in the list of its axis; antennas, baselines or times that all have it alike
    must not be said to be few.
    """
    if told is None:
        return False
    checks = []
    for name, wanted in (("antennas", truth["antennas"]), ("baselines", truth["antpairs"]), ("times", truth["times"])):
        axis = told.get(name)
        if axis is None:
            continue
        if wanted is None:
            others = truth["antennas"] or truth["antpairs"]
            few = axis["state"] == "concentrated" and axis["count"] <= 0.1 * axis["of"]
            checks.append(bool(others) or name == "times" or not few)
            continue
        entries = axis["entries"]
        checks.append(bool(entries) and _share(name, entries, wanted, answer) >= 0.5)
    return all(checks)


def _share(name: str, entries: list[dict[str, Any]], wanted: list[Any], answer: dict[str, Any]) -> float:
    """Return what part of the excess that is listed belongs to what really carries it."""
    if name == "times":
        times = np.array(answer["times"])
        places = [int(np.argmin(np.abs(times - entry["what"]["jd"]))) for entry in entries]
        right = [place in wanted for place in places]
    elif name == "baselines":
        known = {tuple(sorted(pair)) for pair in wanted}
        right = [tuple(sorted(entry["what"])) in known for entry in entries]
    else:
        right = [entry["what"] in wanted for entry in entries]
    shares = np.array([max(entry["share"], 0.0) for entry in entries])
    return float(shares[right].sum() / max(shares.sum(), 1e-300))
