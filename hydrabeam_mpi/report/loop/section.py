"""The section of the page on what the model lacked: the verdict, the rounds, and what is left."""

from __future__ import annotations

from collections.abc import Callable

from hydrabeam_mpi.report.loop.baselines import draw_baselines
from hydrabeam_mpi.report.loop.figures import draw_fall, draw_ranking
from hydrabeam_mpi.report.loop.parameters import draw_parameters
from hydrabeam_mpi.report.loop.record import Entry, entries
from hydrabeam_mpi.report.loop.residuals import draw_residuals
from hydrabeam_mpi.report.loop.statistics import statistics_table
from hydrabeam_mpi.report.loop.structures import draw_singular_values, draw_structures
from hydrabeam_mpi.report.loop.tables import heldout_table, left_out, parameters_table, rounds_table, seconds
from hydrabeam_mpi.report.loop.where import where_tables
from hydrabeam_mpi.report.loop.words import further_words, verdict_words
from hydrabeam_mpi.report.page.sections import as_html
from hydrabeam_mpi.report.page.style import Drawing
from hydrabeam_mpi.setup.findings import Finding

Place = Callable[[Drawing], str]


def loop_section(loop: Entry, place: Place) -> str:
    """Return the section as HTML.

    Parameters
    ----------
    loop : dict
        Of ``loop.json``.
    place : callable
        Turns a figure into its element.
    """
    return "".join(
        [
            "<h2>What the model lacked</h2>\n"
            if any(not one.get("revoked") for one in entries(loop, "rounds"))
            else "<h2>Does the model lack anything?</h2>\n",
            f'<div class="finding verdict"><p>{as_html(verdict_words(loop))}</p></div>\n',
            _health(loop),
            rounds_table(loop),
            heldout_table(loop),
            _placed(place, draw_fall(loop), draw_ranking(loop)),
            _under("<h3>What was added</h3>", _parameters(loop, place)),
            _under("<h2>What is left</h2>", _residual(loop, place)),
            _under("<h3>What no effect explains</h3>", _unexplained(loop, place)),
            _under("<h2>What was not added, and why</h2>", _left_out(loop)),
        ]
    )


def _placed(place: Place, *drawings: Drawing | None) -> str:
    return "".join(place(drawing) for drawing in drawings if drawing is not None)


def _health(loop: Entry) -> str:
    """List what was found wrong with the data themselves, before and after a fit."""
    said = "".join(f"<li>{as_html(Finding.of_record(one).line)}</li>" for one in entries(loop, "health"))
    return f"<p>Of the data themselves:</p><ul>{said}</ul>\n" if said else ""


def _under(heading: str, inside: str) -> str:
    """Return what is inside under its heading; nothing where there is nothing."""
    return f"{heading}\n{inside}" if inside else ""


def _parameters(loop: Entry, place: Place) -> str:
    return "".join(
        _placed(place, draw_parameters(entry, count)) + parameters_table(entry)
        for count, entry in enumerate(entries(loop, "rounds"), 1)
    )


def _residual(loop: Entry, place: Place) -> str:
    return statistics_table(loop) + _placed(place, draw_residuals(loop), draw_baselines(loop))


def _unexplained(loop: Entry, place: Place) -> str:
    structures = loop.get("structures")
    return where_tables(loop) + _placed(place, draw_singular_values(structures), draw_structures(structures))


def _left_out(loop: Entry) -> str:
    said = "".join(f"<li>{as_html(line)}</li>" for line in further_words(loop))
    closing = f"<details><summary>How the loop put it</summary><ul>{said}</ul></details>\n"
    return left_out(loop) + (closing if said else "") + seconds(loop)
