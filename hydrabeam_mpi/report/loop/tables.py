"""The tables of the loop: rounds, the largest parameters, and what was not added."""

from __future__ import annotations

import math
from collections.abc import Sequence

from markupsafe import Markup

from hydrabeam_mpi.report.loop.record import (
    Entry,
    candidate_name,
    entries,
    number,
    runner_up,
    sigmas,
    title_of,
    written,
)
from hydrabeam_mpi.report.loop.words import round_words
from hydrabeam_mpi.report.page.key_numbers import Kind
from hydrabeam_mpi.report.page.parts import part, set_table, together, under
from hydrabeam_mpi.report.page.words import megahertz
from hydrabeam_mpi.words import effect_words, joined

LISTED = 12
"""Parameters of an effect that the page lists."""


def _change(entry: Entry, name: str, kind: Kind = "number") -> str:
    return " → ".join(written(number(entry, f"{name}_{when}"), kind) for when in ("before", "after"))


def rounds_table(loop: Entry) -> Markup:
    """Set the rounds, two lines each: the numbers, and the sentence below them."""
    names = ["", "added", "ln Bayes factor", "absorbed by beam", "χ² fitted", "χ² held out", "rms held out, Jy"]
    names += ["runner-up", "indistinguishable from"]
    rows: list[tuple[str, ...]] = []
    for count, entry in enumerate(entries(loop, "rounds"), 1):
        cells = (
            str(count),
            title_of(entry),
            written(number(entry, "log_bayes_factor")),
            written(number(entry, "absorbed_by_beam"), "percent"),
            _change(entry, "chi2"),
            _change(entry, "heldout"),
            _change(entry, "rms"),
            runner_up(entry) or "–",
            joined([candidate_name(one) for one in entries(entry, "indistinguishable_from")]) or "–",
        )
        rows.append(cells)
        words = round_words(entry)
        if words:
            rows.append(("", words))
    return under("Rounds", set_table(names, rows, range(2, 7), "channels rounds")) if rows else Markup()


def heldout_table(loop: Entry) -> Markup:
    """Set how near the held-out data are predicted: of all channels and of each; empty in older results.

    In two tables: residuals in Jy, and what follows from them.
    """
    powers = ("zero", "model", "model_scaled", "before", "after", "noise")
    in_jy = ["", "zero", "model beam", "its best scale", "before", "after", "noise alone"]
    names = ["", "explained", "χ² predictive", "χ² over the noise", "ln density"]
    channels = entries(loop, "heldout_channels")
    rows = [("all", loop)] if math.isfinite(number(loop, "rms_after")) else []
    rows += [(megahertz(number(one, "freq_hz")), one) for one in channels] if len(channels) > 1 else []
    if not rows:
        return Markup()
    rms = [(name, *(written(number(one, f"rms_{key}")) for key in powers)) for name, one in rows]
    keys = ("predictive_chi2", "noise_only_chi2", "log_density")
    lines = [(name, _change(one, "explained", "percent"), *(_change(one, key) for key in keys)) for name, one in rows]
    tables = (set_table(heads, cells, range(1, len(heads))) for heads, cells in ((in_jy, rms), (names, lines)))
    return under("What is left of the held-out data, rms in Jy", together(*tables))


def parameters_table(entry: Entry) -> Markup:
    """Fold away those parameters of an effect that are farthest from zero."""
    parameters = entries(entry, "parameters")
    largest = sorted(parameters, key=_significance, reverse=True)[:LISTED]
    if not largest:
        return Markup()
    rows = []
    for parameter in largest:
        freq, significance = number(parameter, "freq_hz"), _significance(parameter)
        rows.append(
            (
                str(parameter.get("name", "")),
                megahertz(freq) if math.isfinite(freq) else "all",
                _to_its_error(number(parameter, "value"), number(parameter, "std")),
                written(number(parameter, "std")),
                str(parameter.get("unit") or ""),
                sigmas(significance) if math.isfinite(significance) else "–",
            )
        )
    table = set_table(("parameter", "frequency", "value", "std", "unit", "in std"), rows, (2, 3, 5))
    what = f"{len(largest)} of {len(parameters):,} values, the farthest from zero in their standard deviations"
    if len(largest) == len(parameters):
        what = "The values"
    if not_told := len(entries(entry, "parameters_not_told")):
        what += f" ({not_told:,} more that the data do not tell)"
    return part("folded", what, table)


def _to_its_error(value: float, std: float) -> str:
    """Write a value to the second digit of its error, where that takes many digits as for a place on the sky."""
    if not (math.isfinite(value) and 0 < std < 1e-2 * abs(value) < 1e4):
        return written(value)
    return f"{value:,.{max(0, 1 - math.floor(math.log10(std)))}f}"


def _significance(parameter: Entry) -> float:
    if "sigma" in parameter:
        sigma = number(parameter, "sigma")
        return sigma if math.isfinite(sigma) else -math.inf
    value, std = number(parameter, "value"), number(parameter, "std")
    return abs(value) / std if std > 0 and math.isfinite(value) else -math.inf


def left_out(loop: Entry) -> Markup:
    """Set what was not added: refused, not decidable, not looked for; and the conventions that were tested."""
    refused = [
        (candidate_name(entry), written(number(entry, "log_bayes_factor")), str(entry.get("reason") or "–"))
        for entry in entries(loop, "tried")
    ]
    degenerate_directions = [
        (effect_words(str(entry.get("what", "–"))), str(entry.get("why") or "–"))
        for entry in entries(loop, "undecidable")
    ]
    skipped = [(title_of(entry), str(entry.get("reason") or "–")) for entry in entries(loop, "skipped")]
    tested = [
        (
            effect_words(str(entry.get("name", "–"))),
            written(number(entry, "chi2")),
            written(number(entry, "explained"), "percent"),
        )
        for entry in entries(loop.get("conventions"), "tested")
    ]
    heads = ("effect", "ln Bayes factor", "why")
    return together(
        _titled("Liked by the fitted data, refused by the held-out data", heads, refused),
        _titled("What these data cannot decide", ("what", "why"), degenerate_directions),
        _titled("Effects that were not looked for", ("effect", "why"), skipped),
        _titled("Conventions that were tested", ("the data taken", "reduced χ²", "power explained"), tested),
    )


def _titled(title: str, names: Sequence[str], rows: Sequence[Sequence[str]]) -> Markup:
    """Set a table under a heading; empty without rows."""
    numeric = ("ln Bayes factor", "reduced χ²", "power explained")
    values = [column for column, name in enumerate(names) if name in numeric]
    return under(title, set_table(names, rows, values)) if rows else Markup()


def seconds(loop: Entry) -> Markup:
    """Tell what took how long."""
    spent = loop.get("seconds") or {}
    known = [f"{effect_words(name)} {written(number(spent, name))} s" for name in spent if number(spent, name) >= 0]
    return part("paragraph", f"Time: {', '.join(known)}.") if known else Markup()
