"""Places along the axes that residuals are sorted by, in words."""

from __future__ import annotations

from typing import Any

from hydrabeam_mpi.report.page.key_numbers import format_value
from hydrabeam_mpi.report.page.words import megahertz

WHOLE = {
    "overall": "the sum of all data",
    "kurtosis": "the kurtosis of all data",
    "unevenness": "the unevenness over {}",
    "correlations": "the correlation {}",
}
QUANTITIES = {
    "antennas": ("antenna {}", 1.0),
    "groups": ("redundant group {}", 1.0),
    "lengths": ("baseline length {} m", 1.0),
    "directions": ("baseline direction {}°", 1.0),
    "lsts": ("LST {} h", 1.0),
    "fringe_rates": ("fringe rate {} mHz", 1e3),
    "delays": ("delay {} ns", 1e9),
}


def place_words(axis: str, what: Any) -> str:
    """Name an entry of an axis, such as "antenna 23", "baseline 3–5" or "LST 3.20 h (JD 2458098.52713)"."""
    if isinstance(what, dict):
        return _time(what)
    if isinstance(what, list):
        name = "baseline" if axis == "baselines" else axis.replace("_", " ")
        return f"{name} {'–'.join(str(part) for part in what)}"
    if axis in WHOLE:
        return WHOLE[axis].format(str(what).replace("_", " "))
    if not isinstance(what, int | float):
        return f"{axis.replace('_', ' ')} {'' if what is None else what}".strip()
    if axis == "freqs":
        return megahertz(what)
    if axis == "times":
        return f"JD {what:.5f}"
    text, factor = QUANTITIES.get(axis, (f"{axis.replace('_', ' ')} {{}}", 1.0))
    value = str(what) if isinstance(what, int) else format_value(what * factor)
    return text.format(value.replace("-", "−"))


def _time(what: dict[str, Any]) -> str:
    jd, lst = what.get("jd"), what.get("lst_h")
    words = [f"LST {lst:.2f} h"] if isinstance(lst, int | float) else []
    words += [f"JD {jd:.5f}"] if isinstance(jd, int | float) else []
    return f"{words[0]} ({words[1]})" if len(words) == 2 else "".join(words) or str(what)
