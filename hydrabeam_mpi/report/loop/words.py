"""What the loop found, in plain words."""

from __future__ import annotations

import math

from hydrabeam_mpi.report.loop.record import Entry, effect_name, entries, joined, number, sigmas, title_of, written


def verdict_words(loop: Entry) -> str:
    """Say what the model lacked and what adding it did to the error on held-out data; broken conventions first."""
    broken = _broken_convention(loop)
    if loop["verdict"] == "convention":
        return (
            f"{broken or 'The data break a convention. '}This is no error of the instrument or of the sky. Nothing "
            f"was fitted to it or looked for beside it, so that the beam below is not to be used: {_fall(loop, False)}."
        )
    names = joined(list(dict.fromkeys(title_of(entry) for entry in entries(loop, "rounds"))))
    fall = _fall(loop, bool(names))
    return broken + _what_it_lacked(loop, names, fall)


def _what_it_lacked(loop: Entry, names: str, fall: str) -> str:
    if loop["verdict"] == "consistent" and not names:
        return f"The model explains the data to the noise; nothing significant is left: {fall}."
    if loop["verdict"] == "interrupted":
        return f"The loop was interrupted; so far the model lacked {names or 'nothing that was found'}: {fall}."
    if loop["verdict"] != "unexplained":
        return f"The model lacked {names or 'something'}, and with that added nothing significant is left: {fall}."
    better = _foreign(loop)
    if names:
        return f"The model lacked {names}, and something else that no known effect explains: {fall}.{better}"
    return f"The data show something that is not in the model and that no known effect explains: {fall}.{better}"


def _foreign(loop: Entry) -> str:
    """Name the control model that would explain more than any effect; empty where none would."""
    control = loop.get("foreign")
    if not isinstance(control, dict):
        return ""
    title, after = str(control.get("title", "")), number(control, "heldout_after")
    to = f", with a held-out reduced χ² of {written(after)}" if math.isfinite(after) else ""
    return f" {title[:1].upper()}{title[1:]} would explain more than any of them{to}."


def _broken_convention(loop: Entry) -> str:
    """Say which convention the data break; empty where they break none."""
    conventions = loop.get("conventions") or {}
    found = conventions.get("found")
    if not found:
        return ""
    remedy = str(conventions.get("remedy") or "").strip().rstrip(".")
    advice = f"{remedy[:1].upper()}{remedy[1:]}. " if remedy else ""
    return f"The data break a convention: {effect_name(str(found))}. {advice}"


def _fall(loop: Entry, amended: bool) -> str:
    """Tell the held-out reduced χ² before and after."""
    before, after = number(loop, "error_before"), number(loop, "error_after")
    known = [value for value in (before, after) if math.isfinite(value)]
    if not known:
        return "no data were held out, so that this is not tested"
    if len(known) == 1 or not amended:
        return f"the held-out reduced χ² is {written(known[-1])}, where a right model gives 1"
    turn = "falls" if after < before else "rises" if before > 1 else "goes"
    return f"the held-out reduced χ² {turn} from {written(before)} to {written(after)}, where a right model gives 1"


def reason_words(loop: Entry) -> str:
    """Say why what is left counts as unexplained; empty where nothing does."""
    why = str(loop.get("why") or "")
    return f"{why[:1].upper()}{why[1:]}." if why else ""


def health_words(loop: Entry) -> list[str]:
    """Say what was found wrong with the data themselves, a line each."""
    said = []
    for one in entries(loop, "health"):
        what, where, why, remedy = (str(one.get(key) or "") for key in ("what", "where", "why", "remedy"))
        said.append(f"{what[:1].upper()}{what[1:]} ({where}): {why}. Remedy: {remedy}.")
    return said


def further_words(loop: Entry) -> list[str]:
    """Return the loop's own sentences except those in the table of rounds."""
    told = {str(entry.get("sentence")) for entry in entries(loop, "rounds")}
    return [str(line) for line in loop.get("said") or [] if line not in told]


def round_words(entry: Entry) -> str:
    """Tell what the columns of the table of rounds leave out."""
    parts = [str(entry["sentence"])] if entry.get("sentence") else []
    n, effective, sigma = (number(entry, key) for key in ("n_parameters", "effective_parameters", "heldout_sigma"))
    if math.isfinite(n):
        of_them = f", {written(effective)} effective" if math.isfinite(effective) else ""
        parts.append(f"{n:,.0f} parameter{'s' if n != 1 else ''}{of_them}.")
    if math.isfinite(sigma):
        parts.append(f"The held-out data confirm it at {sigmas(sigma)}σ.")
    return " ".join(parts)
