"""Where a residual lives, in a sentence."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray, IntArray
from hydrabeam_mpi.inference.significance import SIGNIFICANT_P, sigma_of_log_p
from hydrabeam_mpi.loop.residuals.axes import Axis
from hydrabeam_mpi.words import joined

NAMES = {
    "antennas": "antennas",
    "baselines": "baselines",
    "groups": "redundant groups",
    "lengths": "baseline lengths",
    "directions": "baseline directions",
    "times": "times",
    "lsts": "sidereal times",
    "freqs": "channels",
    "fringe_rates": "fringe rates",
    "delays": "delays",
}
SHAPES = (
    ("lengths", "on baselines of", "m"),
    ("directions", "on baselines pointing", "degrees from East through North"),
)
MOST_NAMED = 4


def sentence(axes: dict[str, Axis], described: dict[str, Any], chosen: dict[str, IntArray], of_baselines: bool) -> str:
    """Say in one or two sentences where the excess lives.

    Parameters
    ----------
    axes : dict of str to Axis
    described : dict
        Of each axis with two entries or more, as in ``where``.
    chosen : dict of str to ndarray of int, (Nchosen,)
        The entries that carry most, of axes that are not even.
    of_baselines : bool
        Whether to name baselines rather than antennas.
    """
    told = {name for name in chosen if described[name]["state"] == "concentrated"}
    phrases: list[str] = []
    if "times" in told or "lsts" in told:
        phrases.append(_times(axes, chosen, "times" if "times" in told else "lsts"))
    if "baselines" in told and of_baselines:
        phrases.append(_items(axes["baselines"], chosen["baselines"], "on", "baselines", _pair))
    elif "antennas" in told:
        phrases.append(_items(axes["antennas"], chosen["antennas"], "on", "antennas", str))
    elif "groups" in told:
        phrases.append(_items(axes["groups"], chosen["groups"], "on", "redundant groups", str))
    else:
        phrases += [
            f"{words} {_span(axes[name].values[chosen[name]])} {unit}" for name, words, unit in SHAPES if name in told
        ]
    if "freqs" in told:
        phrases.append(_items(axes["freqs"], chosen["freqs"], "in", "channels", lambda freq: f"{freq / 1e6:.6g} MHz"))
    for name, words in (("fringe_rates", ("fringe rates", "mHz", 1e3)), ("delays", ("delays", "ns", 1e9))):
        if name in told:
            phrases.append(_spectral(axes[name], chosen[name], *words))
    main = f"It lives {joined(phrases)}." if phrases else "It is concentrated nowhere."
    rest = {
        state: [NAMES[name] for name in described if described[name]["state"] == state] for state in ("uneven", "even")
    }
    if rest["uneven"]:
        main += f" It varies over {joined(rest['uneven'])}."
    if rest["even"]:
        main += f" It is even over {joined(rest['even'])}."
    return main


def of_redundancy(split: dict[str, Any] | None) -> str:
    """Say whether redundant baselines share what is left, as `statistics.redundancy` tells; nothing where it does not.

    Their beam and their sky are the same, so that errors of either are, and those of single antennas are not.
    """
    if split is None:
        return ""
    least = sigma_of_log_p(float(np.log(SIGNIFICANT_P)))
    shared, differ = split["beyond_scatter"] > least, split["scatter"]["sigma"] > least
    means, within = split["common"]["chi2"], split["scatter"]["chi2"]
    numbers = f"reduced chi^2 {means:.4g} of their means, {within:.4g} within groups"
    if shared and differ:
        return f"Redundant baselines share a part of it ({numbers})."
    if shared:
        alike = "it is of the sky, of the beam, or of what else is the same for all antennas"
        return f"Redundant baselines share it ({numbers}): {alike}."
    if differ:
        return f"Redundant baselines do not share it ({numbers}): it is of single antennas or baselines, or noise."
    return ""


def _times(axes: dict[str, Axis], chosen: dict[str, IntArray], name: str) -> str:
    axis, entries = axes[name], chosen[name]
    lsts = np.sort(axis.values[entries])
    gaps = np.diff(lsts, append=lsts[0] + 24)
    start = (int(np.argmax(gaps)) + 1) % len(lsts)  # the range may wrap through zero
    lsts = np.roll(lsts, -start)
    where = f"LST {lsts[0]:.2f}-{lsts[-1]:.2f} h"
    if len(lsts) == 1 or (len(lsts) <= MOST_NAMED and np.ptp(entries) >= len(entries)):
        where = f"LST {', '.join(f'{lst:.2f}' for lst in lsts)} h"
    words = "times" if name == "times" else "half-hours of sidereal time"
    return f"in {len(entries)} of {len(axis)} {words} ({where})"


def _items(axis: Axis, entries: IntArray, preposition: str, plural: str, spell: Callable[[Any], str]) -> str:
    head = f"{preposition} {len(entries)} of {len(axis)} {plural}"
    if len(entries) > MOST_NAMED:
        return head
    return f"{head} ({', '.join(spell(axis.what[k]) for k in entries)})"


def _spectral(axis: Axis, entries: IntArray, words: str, unit: str, factor: float) -> str:
    values = axis.values[entries] * factor
    step = float(np.min(np.diff(axis.values))) * factor
    if np.abs(values).max() <= 1.01 * step:
        return f"with {words} near zero"
    return f"with {words} of {_span(values)} {unit}"


def _span(values: FloatArray) -> str:
    low, high = float(values.min()), float(values.max())
    return f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}"


def _pair(pair: Sequence[int]) -> str:
    return f"{pair[0]}-{pair[1]}"
