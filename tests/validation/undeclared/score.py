"""How a loop's record compares with what was really wrong."""

from __future__ import annotations

from typing import Any

import numpy as np

from tests.validation.undeclared.cases import CONVENTIONS, EFFECTS, FAULTS, NULLS, UNKNOWN
from tests.validation.undeclared.claims import CONVENTION_NAMES, EQUIVALENT, as_good_as, kept, not_so, same
from tests.validation.undeclared.faults_told import faults_not_so, names_fault
from tests.validation.undeclared.match import SIGMAS, Comparison, compare, nearest

LARGEST_CHI2 = 1.1


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
        "class" (`class_of`); "first", what the loop names first and does not revoke, or "none";
        "named": "right", "equivalent" (`EQUIVALENT`), "indistinguishable" (the loop says that it may as well be the
        right one), "wrong" or "none"; "detectable"; "law_named", whether what changes in time is named with its law;
        "z", deviations of parameters in sigma; "parameters_hold";
        "heldout_holds"; "not_so", all that is claimed and is not so; "revoked", rounds that a later one took back, and
        "revoked_so", whether they were right; "at_noise" (`at_noise`); "rms" before, after, expected and
        of the noise, Jy; for pairs and triples "both", all are named, and
        "both_or_indistinguishable", where the loop says of a name that it may as well be the right one; for unknown
        effects "kept_unknown" and "where_right"; for null draws "false_alarm".
    """
    effects = answer["effects"]
    rounds = kept(loop)
    revoked = [one for one in loop["rounds"] if one not in rounds]
    found = [one["effect"] for one in rounds]
    convention = loop.get("conventions", {}).get("found")
    health = [f"health: {one['what']}" for one in loop.get("health") or []]
    first = next(iter([f"convention: {convention}"] if convention else [*found, *health]), "none")
    told: dict[str, Any] = {
        "case": answer["case"],
        "seed": answer["seed"],
        "class": class_of(answer["case"]),
        "strength": [effect["strength"] for effect in effects],
        "chi2_left": [effect["chi2_left"] for effect in effects],
        "absorbed": [1 - effect["chi2_left"] / effect["chi2_total"] for effect in effects],
        "detectable": all(effect["detectable"] or _is_mistake(effect) for effect in effects),
        "basis": answer.get("basis", "study"),
        "first": first,
        "found": found,
        "verdict": loop["verdict"],
        "error_before": loop["error_before"],
        "error_after": loop["error_after"],
        "heldout_holds": bool(loop["error_after"] <= LARGEST_CHI2),
        "not_so": not_so(answer, loop) + faults_not_so(answer, loop),
        "revoked": [one["effect"] for one in revoked],
        "revoked_so": [any(same(effect["kind"], one["effect"]) for effect in effects) for one in revoked],
        "at_noise": at_noise(loop),
        "rms": [loop.get(f"rms_{which}") for which in ("before", "after", "expected", "noise")],
    }
    return told | _judged(told, answer, loop)


def _judged(told: dict[str, Any], answer: dict[str, Any], loop: dict[str, Any]) -> dict[str, Any]:
    """Return what is judged of draws of one class alone."""
    effects, rounds = answer["effects"], kept(loop)
    if not effects:
        return {"false_alarm": bool(told["not_so"] or loop["verdict"] != "consistent")}
    if told["class"] == "unknown":
        where_right = is_where(effects[0]["where"], loop.get("where"), answer)
        # What carries it may also be left out of the data, if nothing else is.
        said = bool(loop.get("health")) or any(one.get("of_unknown") for one in rounds)
        left_out = said and not told["not_so"]
        return {
            "kept_unknown": left_out or loop["verdict"] == "unexplained",
            "where_right": left_out or where_right,
        }
    if told["class"] == "convention":
        return {"named": _named_convention(effects[0]["kind"], told["first"], loop["verdict"])}
    faults = {effect["kind"] for effect in effects if effect["kind"] in FAULTS and names_fault(effect, loop, answer)}
    out: dict[str, Any] = {"named": "right" if faults else _named(effects, rounds)}
    if told["class"] in ("pair", "triple"):
        allowed = {*told["found"], *(kind for one in rounds for kind in as_good_as(one))}
        for key, names in (("both", told["found"]), ("both_or_indistinguishable", allowed)):
            wanted = {effect["kind"] for effect in effects} - faults
            out[key] = all(any(same(kind, name) for name in names) for kind in wanted)
    changing = [effect for effect in effects if law_of(effect) != "constant"]
    out["law_named"] = all(_round_of(effect, rounds) is not None for effect in changing) if changing else None
    comparisons = _comparisons(effects, rounds, answer)
    holds = [one.holds for one in comparisons if one.holds is not None]
    out["z"] = [float(z) for one in comparisons for z in one.z]
    return out | {"parameters_hold": all(holds) if holds else None}


def _is_mistake(effect: dict[str, Any]) -> bool:
    """Tell whether an effect is a mistake of the file; antennas may be in the order of their names already."""
    if effect["kind"] in CONVENTIONS:
        return bool(effect["about"].get("antennas that moved") != 0)
    # A beam of another size takes up the scale of all data, but none has that size.
    return bool(effect["kind"] == "wrong_scale")


def class_of(case: str) -> str:
    """Return what sort of draw a case is: "null", "single", "fault", "convention", "unknown", "pair" or "triple"."""
    if "+" in case:
        return "pair" if case.count("+") == 1 else "triple"
    sorts = {"fault": FAULTS, "convention": CONVENTIONS, "unknown": UNKNOWN}
    return next((sort for sort, cases in sorts.items() if case in cases), "null" if case in NULLS else "single")


def at_noise(loop: dict[str, Any]) -> bool | None:
    """Tell whether the rms of the held-out residuals is that of the noise and of what the data leave open of the beam.

    It lies, within three standard errors, between the noise alone and both: the beam may be better than its prior lets
    one expect. None where the loop does not say that all is explained, or how large it should be.
    """
    noise, expected = loop.get("rms_noise"), loop.get("rms_expected")
    if loop["verdict"] not in ("explained", "consistent") or not noise or not expected:
        return None
    error = SIGMAS / (2 * np.sqrt(loop["heldout_n"]))
    return bool(noise * (1 - error) <= loop["rms_after"] <= expected * (1 + error))


def _named(effects: list[dict[str, Any]], rounds: list[dict[str, Any]]) -> str:
    """Judge the first name."""
    if not rounds:
        return "none"
    kinds = [effect["kind"] for effect in effects]
    first = rounds[0]
    if first["effect"] in kinds:
        return "right"
    if any(same(kind, first["effect"]) for kind in kinds):
        return "equivalent"
    return "indistinguishable" if set(kinds) & as_good_as(first) else "wrong"


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
        named = _round_of(effect, rounds)
        if named is not None and effect["kind"] in EFFECTS:
            out.append(compare(effect, nearest(effect, named, answer), answer))
    return out


def law_of(told: dict[str, Any]) -> str:
    """Return how an effect, of an answer or of a round, goes on in time."""
    return str(told.get("law") or "constant")


def _round_of(effect: dict[str, Any], rounds: list[dict[str, Any]]) -> dict[str, Any] | None:
    """Return the first round that names an effect with its law."""
    same_law = (one for one in rounds if one["effect"] == effect["kind"] and law_of(one) == law_of(effect))
    return next(same_law, None)


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
