"""What to leave out where a residual that no effect explains is in few integrations, antennas or baselines."""

from __future__ import annotations

from typing import Any

from hydrabeam_mpi.data.observation import Observation
from hydrabeam_mpi.setup.findings import Finding, antenna_words, baseline_words, integration_words

NAMES = {
    "times": "an integration that stands out",
    "antennas": "an antenna that stands out",
    "baselines": "a baseline that stands out",
}


def leave_out(where: dict[str, Any], observation: Observation) -> list[Finding]:
    """Return a line for each integration, antenna and baseline in which an unexplained residual is concentrated.

    Nothing is left out by itself: the loop cannot tell bad data from an effect that it does not know.

    Parameters
    ----------
    where : dict
        As of `hydrabeam_mpi.loop.residuals.localise.where`.
    observation : Observation
    """
    found: list[Finding] = []
    shortest = float(observation.integration_time.min())
    for axis, name in NAMES.items():
        described = where.get(axis) or {}
        # Baselines are told only where antennas do not tell them all.
        told = axis == "baselines" and any(one.what == NAMES["antennas"] for one in found)
        if described.get("state") != "concentrated" or told:
            continue
        for entry in described.get("entries", [])[: described.get("count")]:
            place, key = _named(axis, entry["what"], shortest)
            why = f"it has {entry['share']:.0%} of what no effect explains ({entry['sigma']:.1f} sigma)"
            found.append(Finding(name, place, why, f"if it is bad, {key}"))
    return found


def _named(axis: str, what: Any, seconds: float) -> tuple[str, str]:
    """Return the name of an entry, and the key of a job that leaves it out."""
    if axis == "times":
        return integration_words(float(what["jd"]), seconds)[:2]
    return antenna_words(what) if axis == "antennas" else baseline_words(*what)
