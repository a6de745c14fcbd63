"""What a loop adds to the page: the verdict, what the model lacked, and what is left."""

from __future__ import annotations

import math
from collections.abc import Callable

from markupsafe import Markup

from hydrabeam_mpi.report.loop.figures import draw_fall, draw_ranking
from hydrabeam_mpi.report.loop.parameters import draw_parameters
from hydrabeam_mpi.report.loop.record import Entry, entries, number, written
from hydrabeam_mpi.report.loop.residuals import draw_residuals
from hydrabeam_mpi.report.loop.statistics import statistics_table
from hydrabeam_mpi.report.loop.structures import draw_singular_values, draw_structures
from hydrabeam_mpi.report.loop.tables import heldout_table, left_out, parameters_table, rounds_table, seconds
from hydrabeam_mpi.report.loop.where import where_tables
from hydrabeam_mpi.report.loop.words import further_words, verdict_words
from hydrabeam_mpi.report.page.parts import Answer, Section, bullets, part, set_table, together, under
from hydrabeam_mpi.report.page.style import Drawing
from hydrabeam_mpi.setup.findings import Finding

Place = Callable[[Drawing], Markup]
ERRORS = {
    "reduced χ² of held-out data": "error",
    "rms residual of held-out data, Jy": "rms",
}
"""Measures of the error, by their keys in ``loop.json``."""


def loop_answer(loop: Entry, picture: Markup, warnings: list[str]) -> Answer:
    """Begin the page with the verdict, and the error before and after.

    Parameters
    ----------
    loop : dict
        Of ``loop.json``.
    picture : Markup
        The beam of the amended model.
    warnings : list of str
        What is said of its posterior; what is wrong with the data themselves is put before it, and said once.
    """
    rows = []
    for what, key in ERRORS.items():
        values = [number(loop, f"{key}_{when}") for when in ("before", "after")]
        if all(map(math.isfinite, values)):
            rows.append((what, *map(written, values)))
    table = set_table(("", "before", "after"), rows, (1, 2)) if rows else Markup()
    health = [Finding.of_record(one).line for one in entries(loop, "health")]
    told = [f"Of the data themselves: {line}" for line in health]
    return Answer(verdict_words(loop), table, picture, [*told, *(one for one in warnings if one not in health)])


def loop_sections(loop: Entry, place: Place) -> list[Section]:
    """Return the sections on what was added, what is left, and what was not added.

    Parameters
    ----------
    loop : dict
        Of ``loop.json``.
    place : callable
        Turns a figure into its element.
    """
    added = any(not one.get("revoked") for one in entries(loop, "rounds"))
    lacked = together(
        rounds_table(loop),
        heldout_table(loop),
        under("The beam's prior", bullets([str(one["sentence"]) for one in entries(loop, "prior_widths")])),
        _placed(place, draw_fall(loop), draw_ranking(loop)),
        under("What was added", _parameters(loop, place)),
    )
    left = together(_residual(loop, place), under("What no effect explains", _unexplained(loop, place)))
    return [
        Section("What the model lacked" if added else "Does the model lack anything?", lacked),
        Section("What is left", left),
        Section("What was not added, and why", _left_out(loop)),
    ]


def _placed(place: Place, *drawings: Drawing | None) -> Markup:
    return together(*(place(drawing) for drawing in drawings if drawing is not None))


def _parameters(loop: Entry, place: Place) -> Markup:
    pairs = (
        (_placed(place, draw_parameters(entry, count)), parameters_table(entry))
        for count, entry in enumerate(entries(loop, "rounds"), 1)
    )
    return together(*(piece for pair in pairs for piece in pair))


def _residual(loop: Entry, place: Place) -> Markup:
    return together(statistics_table(loop), _placed(place, draw_residuals(loop)))


def _unexplained(loop: Entry, place: Place) -> Markup:
    structures = loop.get("structures")
    return together(where_tables(loop), _placed(place, draw_singular_values(structures), draw_structures(structures)))


def _left_out(loop: Entry) -> Markup:
    said = bullets(further_words(loop))
    closing = part("folded", "How the loop put it", said) if said else said
    return together(left_out(loop), closing, seconds(loop))
