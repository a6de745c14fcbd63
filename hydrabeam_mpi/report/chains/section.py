"""The page of a folder of chains: do they mix, and what do beam and all else owe to each other."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from html import escape

from hydrabeam_mpi.report.chains.degeneracy import directions_of, draw_directions
from hydrabeam_mpi.report.chains.mixing import draw_ess, mixing_rows, progress_rows
from hydrabeam_mpi.report.chains.pooled import pool
from hydrabeam_mpi.report.chains.traces import draw_traces
from hydrabeam_mpi.report.chains.uncertainty import draw_spread, spread_of
from hydrabeam_mpi.report.page.sections import as_html
from hydrabeam_mpi.report.page.style import Drawing
from hydrabeam_mpi.report.page.words import megahertz
from hydrabeam_mpi.sampling.status import Status
from hydrabeam_mpi.sampling.storage.store import ChainStore

CONDITIONAL = "conditional"
"""Name of what chains keep of the beam given all else."""
Place = Callable[[Drawing], str]


def chains_body(store: ChainStore, status: Status, place: Place) -> str:
    """Return the body of the page as HTML.

    Parameters
    ----------
    store : ChainStore
    status : Status
        Of it.
    place : callable
        Turns a figure into its element.

    Raises
    ------
    InputError
        If the chains cannot be read.
    """
    diagnosis = status.diagnosis
    parts = [
        f"<p>{escape(introduction(store, status))}</p>\n",
        _warnings(status),
        f"<h2>Do the chains agree?</h2>\n{mixing_rows(diagnosis)}",
        *map(place, _drawn(draw_ess(diagnosis), draw_traces(store, diagnosis))),
        f"<p>{escape(str(status.held_out or ''))}</p>\n",
        f"<h2>How far they are</h2>\n{progress_rows(status)}",
        _beam(store, place),
    ]
    return "".join(parts)


def introduction(store: ChainStore, status: Status) -> str:
    """Tell in a paragraph what was drawn."""
    diagnosis = status.diagnosis
    blocks = ", ".join(one.block for one in diagnosis.blocks)
    text = f"Draws from the joint posterior of {blocks}: {diagnosis.n_draws} of each of {len(diagnosis.chains)} chains"
    text += f", after {store.warm_up} of warm-up that are left out." if store.warm_up else "."
    short = store.chains - len(diagnosis.chains)
    return text + (f" {short} more have not come half as far, and are left out." if short else "")


def _warnings(status: Status) -> str:
    said = "".join(f"<li>{as_html(line)}</li>" for line in status.cautions)
    return f'<div class="warnings"><p>Read this first</p><ul>{said}</ul></div>\n' if said else ""


def _beam(store: ChainStore, place: Place) -> str:
    """Return what the chains say of the beam, in the first channel."""
    pooled = pool(store)
    if pooled is None:
        return ""
    spread = spread_of(pooled, store.kept(CONDITIONAL))
    directions, chance = directions_of(pooled)
    drawings = [
        *map(place, _drawn(draw_spread(spread) if spread else None, draw_directions(pooled, directions, chance)))
    ]
    said = []
    if spread is None and pooled.labels:
        said.append("There are too few draws to tell what part the other blocks have in the beam's uncertainty.")
    if not directions and pooled.labels:
        said.append("No direction in which the beam and the other blocks trade off is beyond chance.")
    where = f", {megahertz(pooled.freq)}" if pooled.freq is not None else ""
    words = "".join(f"<p>{line}</p>\n" for line in said)
    return f"<h2>The beam and all else{where}</h2>\n{''.join(drawings)}{words}" if drawings or said else ""


def _drawn(*drawings: Drawing | None) -> Iterator[Drawing]:
    return (one for one in drawings if one is not None)
