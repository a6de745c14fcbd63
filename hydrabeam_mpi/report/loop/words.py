"""What the loop found, in plain words: its own sentences, and what the report adds to them."""

from __future__ import annotations

import math

from hydrabeam_mpi.report.loop.record import Entry, entries, number, sigmas, written


def verdict_words(loop: Entry) -> str:
    """Return the loop's own sentence on how it ended."""
    return str(loop.get("sentence") or f"The loop ended with the verdict '{loop['verdict']}'.")


def further_words(loop: Entry) -> list[str]:
    """Return the loop's own sentences except the verdict and those of rounds and of the beam's prior."""
    told = {str(entry.get("sentence")) for entry in (loop, *entries(loop, "rounds"), *entries(loop, "prior_widths"))}
    return [str(line) for line in loop.get("said") or [] if line not in told]


def round_words(entry: Entry) -> str:
    """Tell what the columns of the table of rounds leave out."""
    parts = [str(entry["sentence"])] if entry.get("sentence") else []
    n, effective, sigma = (number(entry, key) for key in ("n_parameters", "effective_parameters", "heldout_sigma"))
    if math.isfinite(n):
        of_them = f", {written(effective)} effective" if math.isfinite(effective) else ""
        parts.append(f"{n:,.0f} parameter{'s' if n != 1 else ''}{of_them}.")
    if math.isfinite(sigma) and not entry.get("revoked"):
        parts.append(f"The held-out data confirm it at {sigmas(sigma)}σ.")
    return " ".join(parts)
