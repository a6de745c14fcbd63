"""What a loop says of data, and what of that is not so."""

from __future__ import annotations

import re
from typing import Any

from tests.validation.undeclared.match import averaged, compare, nearest, read_sources

CLAIMED = 5.0
"""Standard deviations from which on a number says that something is there. A draw compares up to two hundred."""

EQUIVALENT = {
    ("auto_coupling", "cross_coupling"): "an autocorrelation that hardly changes with time is a constant",
    ("cross_coupling", "auto_coupling"): "an autocorrelation that hardly changes with time is a constant",
    ("convention: times in TAI", "timestamp"): "a clock that is wrong by a number of seconds is a timestamp offset",
    ("faint_sources", "missing_sources"): "the brightest of them, one by one",
    ("bad_integrations", "outliers"): "their rows are left out, though nobody says that they go together",
}
"""(what is so, what may be said instead): physically the same, so that either name is right."""

PARTLY_SO = {
    ("drifting_noise", "noise_level"): "there is more of it than its weights say",
    ("correlated_noise", "noise_level"): "there is more of it than its weights say",
    ("elongated_source", "resolved_source"): "it is wide",
    ("polarised_sources", "catalogue_flux"): "it varies, as the feed turns",
    ("board_drops_packets", "closure_errors"): "its baselines' mean factor of the night is another",
    ("board_stops_wrong_fringes", "closure_errors"): "its baselines' mean factor of the night is another",
}
"""(what is so, what may be said of it): not all of it, yet nothing that is not so."""

LEFT_OUT = ("bad_integrations", "bad_baselines")
"""Not wrong as names: `faults_told.faults_not_so` asks of each integration, antenna and baseline that is left out
whether it may be."""

OF_UNKNOWN = "unknown_integrations"
"""Left out as something is in them that nobody knows: so where something is wrong that is not named."""

CONVENTION_NAMES = {
    "conjugated": "conjugated",
    "halved": "factor 1/2",
    "doubled": "factor 2",
    "north and east exchanged": "north and east swapped",
    "times in TAI": "times in TAI",
    "antennas sorted by name": "positions sorted by name, antennas not",
}
"""What the loop calls the mistakes of `conventions`."""

THING = re.compile(r"antenna \d+|baseline \d+-\d+|source \d+(?=:)|source at ra=\S+ dec=[-\d.]+(?=:)")


def kept(loop: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the rounds that no later one has revoked."""
    return [one for one in loop["rounds"] if not one.get("revoked")]


def as_good_as(one: dict[str, Any]) -> set[str]:
    """Return the kinds of effects that a round says it cannot be told from."""
    return {other["effect"] for other in one["indistinguishable_from"]}


def same(kind: str, name: str) -> bool:
    """Tell whether a name is right."""
    return kind == name or (kind, name) in EQUIVALENT


def not_so(answer: dict[str, Any], loop: dict[str, Any]) -> list[str]:
    """Name all that is claimed and is not so: effects, antennas, baselines and sources that have none, conventions.

    What a later round revoked was not claimed in the end. A round that says that it may as well be the right effect
    claims nothing wrong.
    """
    kinds = [effect["kind"] for effect in answer["effects"]]
    out = []
    convention = (loop.get("conventions") or {}).get("found")
    wanted = [CONVENTION_NAMES.get(kind.removeprefix("convention: ")) for kind in kinds]
    if convention is not None and convention not in wanted:
        out.append(f"convention: {convention}")
    for one in kept(loop):
        name = one["effect"]
        if name == f"convention: {convention}" or name in LEFT_OUT:
            continue
        if name == OF_UNKNOWN:
            named = [any(same(kind, other["effect"]) for other in kept(loop)) for kind in kinds]
            out += [name] if all(named) else []
            continue
        so = [
            effect
            for effect in answer["effects"]
            if same(effect["kind"], name) or (effect["kind"], name) in PARTLY_SO or effect["kind"] in as_good_as(one)
        ]
        if not so:
            out.append(name)
        out += [f"{name}: {thing}" for thing in _without_effect(so, one, answer)]
    return out


def _without_effect(so: list[dict[str, Any]], found: dict[str, Any], answer: dict[str, Any]) -> list[str]:
    """Return the things that a round says something of although they have nothing of its effect."""
    effect = next((effect for effect in so if effect["kind"] == found["effect"] and effect["parameters"]), None)
    if effect is None:
        return []
    idle, have = set(), set()
    for p in effect["parameters"]:
        (idle if p["value"] == (1.0 if p["quantity"] == "noise scale" else 0.0) else have).add(p["thing"])
    found = nearest(effect, found, answer)
    comparison = compare(effect, found, answer)
    wrong = {
        thing
        for (thing, _), z in zip(comparison.of, comparison.z, strict=True)
        if thing in idle - have and abs(z) > CLAIMED
    }
    for name, (value, std) in averaged(found["parameters"]).items():
        match = THING.match(name)
        # A place is no claim; that there is a flux at it is.
        if match is None or abs(value) <= CLAIMED * std or name.endswith((": right ascension", ": declination")):
            continue
        if not _is_among(match[0], idle | have, effect, found, answer):
            wrong.add(match[0])
    return sorted(wrong)


def _is_among(
    thing: str, known: set[str], effect: dict[str, Any], found: dict[str, Any], answer: dict[str, Any]
) -> bool:
    """Tell whether a thing is among those of the answer; sources by their places, baselines either way round."""
    if thing.startswith("source at"):
        truth = {(p["thing"], p["quantity"]): p["value"] for p in effect["parameters"]}
        own = [p for p in found["parameters"] if p["name"].startswith(thing + ":")]
        return bool(read_sources(own, truth, answer))
    if thing.startswith("baseline"):
        two = set(thing.split(" ")[1].split("-"))
        return any(set(name.split(" ")[1].split("-")) == two for name in known if name.startswith("baseline"))
    return thing in known or not any(name.split(" ")[0] == thing.split(" ")[0] for name in known)
