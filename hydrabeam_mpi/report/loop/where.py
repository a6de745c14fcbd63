"""Where the unexplained residual lives, as tables."""

from __future__ import annotations

import math
from typing import Any

from markupsafe import Markup

from hydrabeam_mpi.report.loop.record import Entry, entries, number, sigmas, written
from hydrabeam_mpi.report.page.parts import part, set_table, together
from hydrabeam_mpi.report.page.places import place_words
from hydrabeam_mpi.words import effect_words

NAMED, LISTED = 3, 10


def where_tables(loop: Entry) -> Markup:
    """Set how the residual spreads over every axis, and fold away the entries that carry it."""
    axes = {name: axis for name, axis in (loop.get("where") or {}).items() if isinstance(axis, dict)}
    if not axes:
        return Markup()
    overview = [(effect_words(name), *_overview(name, axis)) for name, axis in axes.items()]
    heads = ["over", "the excess is", "carry 2/3 of it", "unevenness, σ", "the strongest, with their shares"]
    parts = [set_table(heads, overview, (2, 3))]
    rows = [row for name, axis in axes.items() for row in _rows(name, axis)]
    if rows:
        table = set_table(["where", "χ²", "σ", "share of the excess"], rows, (1, 2, 3))
        parts.append(part("folded", f"Up to {LISTED} of each, the strongest first", table))
    return together(*parts)


def _overview(name: str, axis: Entry) -> tuple[str, str, str, str]:
    count, total = number(axis, "count"), number(axis, "of")
    carried = f"{count:,.0f} of {total:,.0f}" if math.isfinite(count) and math.isfinite(total) else "–"
    strongest = ", ".join(
        f"{place_words(name, entry.get('what'))} ({written(number(entry, 'share'), 'percent')})"
        for entry in entries(axis, "entries")[:NAMED]
    )
    return str(axis.get("state", "–")), carried, sigmas(number(axis, "sigma")), strongest or "–"


def _rows(name: str, axis: Entry) -> list[tuple[str, ...]]:
    return [
        (
            f"{place_words(name, entry.get('what'))}{_more(entry)}",
            written(number(entry, "chi2")),
            sigmas(number(entry, "sigma")),
            written(number(entry, "share"), "percent"),
        )
        for entry in entries(axis, "entries")[:LISTED]
    ]


def _more(entry: Entry) -> str:
    """Tell the vector of a redundant group or the range of a bin of lengths."""
    vector: Any = entry.get("vector_m")
    if isinstance(vector, list) and len(vector) >= 2:
        return f" ({vector[0]:.1f} m East, {vector[1]:.1f} m North)"
    return ""
