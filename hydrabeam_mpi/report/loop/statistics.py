"""The residual in numbers: a table of its statistics before the first round and after the last."""

from __future__ import annotations

import math
from collections.abc import Iterator

from markupsafe import Markup

from hydrabeam_mpi.report.loop.record import Entry, entries, first_statistics, number, sigmas, written
from hydrabeam_mpi.report.page.key_numbers import format_value
from hydrabeam_mpi.report.page.parts import part, set_table, together, under
from hydrabeam_mpi.report.page.places import place_words


def statistics_table(loop: Entry) -> Markup:
    """Set what is known of the residual as a whole, before and after; empty where nothing is."""
    states = [dict(_rows(state)) for state in (first_statistics(loop), loop.get("residual")) if state]
    names = list(dict.fromkeys(name for state in states for name in state))
    if not names:
        return Markup()
    missing = ("–", "–")
    rows = [(name, *(cell for state in states for cell in state.get(name, missing))) for name in names]
    heads = ("before", "in σ", "after", "in σ") if len(states) == 2 else ("value", "in σ")
    table = set_table(("held-out residual", *heads), rows, range(1, 1 + len(heads)))
    return under("The residual in numbers", together(table, _worst(loop)))


def _rows(state: Entry) -> Iterator[tuple[str, tuple[str, str]]]:
    """Yield a name, and a value with its significance, both written."""
    yield from _known("reduced χ², noise alone gives 1", state.get("overall"), "chi2")
    redundancy = state.get("redundancy") or {}
    yield from _known("reduced χ² of what redundant baselines have in common", redundancy.get("common"), "chi2")
    yield from _known("reduced χ² of how redundant baselines differ", redundancy.get("scatter"), "chi2")
    for pair in entries(state, "correlations"):
        yield from _known(f"correlation, {pair.get('what', '')}", pair, "correlation")
    for look in entries(state, "coherent"):
        name = f"{look.get('kind', '')}, the most significant of {format_value(number(look, 'n'), 'count')}"
        yield name, (str(look.get("what") or "–"), sigmas(number(look, "sigma")))
    tails = state.get("tails") or {}
    yield from _known("excess kurtosis, 0 for Gaussian noise", tails.get("kurtosis"), "excess")
    largest = tails.get("largest") or {}
    if math.isfinite(number(largest, "z")):
        sigma = number(largest, "corrected_sigma")
        yield "largest |z| of all visibilities", (written(number(largest, "z")), sigmas(sigma))


def _known(name: str, record: Entry | None, key: str) -> Iterator[tuple[str, tuple[str, str]]]:
    value = number(record, key)
    if math.isfinite(value):
        yield name, (written(value), sigmas(number(record, "sigma")))


def _worst(loop: Entry) -> Markup:
    """Tell what stands out most in the last residual."""
    state = loop.get("residual") or {}
    found, looks = state.get("significance") or {}, number(state, "looks")
    sigma, chance = number(found, "sigma"), number(found, "p")
    if not (found.get("axis") and math.isfinite(sigma)):
        return Markup()
    of_all = f" of {format_value(looks, 'count')} looks" if math.isfinite(looks) else ""
    chance_words = ""
    if math.isfinite(chance):
        small = "less than 1e-300" if chance == 0 else written(chance)
        chance_words = f"; the probability of such a find in noise alone is {small}, all looks counted"
    place = place_words(str(found["axis"]), found.get("what"))
    when = "After the last round" if entries(loop, "rounds") else "Of all that was looked at,"
    text = f"{when} {place} stands out most{of_all}: {sigmas(sigma)}σ{chance_words}."
    return part("paragraph", text)
