"""What a loop says of the health of data: flux scale, antennas, integrations and baselines that should not be used."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from tests.validation.undeclared.cases import FAULTS, UNKNOWN

SCALE_WITHIN = 0.2
"""Relative: the model beam's visibilities, to which data are compared, are not right to better than that."""
SCALED = ("wrong_scale", "convention: halved", "convention: doubled")
NEAR = 1e-6
"""Days within which a Julian date is that of an integration, told as it is to six digits."""
NOISY = ("noise_level", "drifting_noise", "correlated_noise", "outliers", "bad_integrations")


def remedies(loop: dict[str, Any], key: str) -> list[Any]:
    """Return what the loop would have for a key of ``[data]``: the numbers of its remedies, ``key = ...``."""
    said = [one["remedy"].partition(f"{key} = ")[2] for one in loop.get("health") or []]
    return [json.JSONDecoder().raw_decode(after)[0] for after in said if after]


def bad_times(loop: dict[str, Any], answer: dict[str, Any]) -> list[int]:
    """Return the indices of integrations that the loop leaves out."""
    spans = [span for spans in remedies(loop, "exclude_times") for span in spans]
    # "JD ... noise scale" are the integrations that a round says are bad.
    names = [known["name"] for one in _rounds(loop, "bad_integrations") for known in one["parameters"]]
    spans += [(float(name.split()[1]) - NEAR, float(name.split()[1]) + NEAR) for name in names]
    return [i for i, time in enumerate(answer["times"]) if any(low <= time <= high for low, high in spans)]


def _rounds(loop: dict[str, Any], kind: str) -> list[dict[str, Any]]:
    """Return the rounds of a kind that no later one has revoked."""
    return [one for one in loop["rounds"] if one["effect"] == kind and not one.get("revoked")]


def _left_out(loop: dict[str, Any], axis: str) -> list[Any]:
    """Return the antennas or baselines all of which a round leaves out."""
    told = [what for one in _rounds(loop, "bad_baselines") for what in one["left_out"][axis]]
    return [one["what"] for one in told if one["n"] == one["of"]]


def bad_antennas(loop: dict[str, Any]) -> list[int]:
    """Return the numbers of antennas that the loop leaves out."""
    said = {number for numbers in remedies(loop, "exclude_antennas") for number in numbers}
    return sorted({*said, *_left_out(loop, "antennas")})


def bad_antpairs(loop: dict[str, Any]) -> list[list[int]]:
    """Return the baselines that the loop leaves out, the smaller number first."""
    said = [pair for pairs in remedies(loop, "exclude_baselines") for pair in pairs]
    return sorted(sorted(pair) for pair in [*said, *_left_out(loop, "baselines")])


def names_fault(effect: dict[str, Any], loop: dict[str, Any], answer: dict[str, Any]) -> bool:
    """Tell whether the loop says of a fault of `cases.FAULTS` what it is, all of it and no more."""
    if effect["kind"] == "wrong_scale":
        scales = np.array(remedies(loop, "flux_scale")) * effect["parameters"][0]["value"]
        return bool(len(scales)) and bool(np.all(np.abs(scales - 1) < SCALE_WITHIN))
    if effect["kind"] == "dead_antennas":
        return bad_antennas(loop) == sorted(effect["where"]["antennas"])
    return bad_times(loop, answer) == effect["where"]["times"]


def faults_not_so(answer: dict[str, Any], loop: dict[str, Any]) -> list[str]:
    """Name what the loop says of the data's health that is not so.

    What carries an effect of no known kind may be left out.
    """
    kinds = [effect["kind"] for effect in answer["effects"]]
    where = [effect["where"] for effect in answer["effects"] if effect["kind"] in FAULTS | UNKNOWN]

    def carrying(axis: str) -> list[Any]:
        return [what for one in where for what in one[axis] or []]

    pairs = [sorted(pair) for pair in carrying("antpairs")]
    out = [f"bad antenna: {number}" for number in bad_antennas(loop) if number not in carrying("antennas")]
    out += [f"bad integration: {time}" for time in bad_times(loop, answer) if time not in carrying("times")]
    out += [f"bad baseline: {one}-{two}" for one, two in bad_antpairs(loop) if [one, two] not in pairs]
    if remedies(loop, "flux_scale") and not any(kind in SCALED for kind in kinds):
        out.append("wrong flux scale")
    known = ("exclude_times", "exclude_antennas", "exclude_baselines", "flux_scale")
    others = [one["what"] for one in loop.get("health") or [] if not any(key in one["remedy"] for key in known)]
    return out + [what for what in others if not any(kind in NOISY for kind in kinds)]
