"""The page of a folder of chains: do they mix, and what do beam and all else owe to each other."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from markupsafe import Markup

from hydrabeam_mpi.report.chains.channels import channel_rows
from hydrabeam_mpi.report.chains.degeneracy import directions_of, draw_directions
from hydrabeam_mpi.report.chains.mixing import draw_ess, mixing_rows, progress_rows
from hydrabeam_mpi.report.chains.pooled import Pooled, pool
from hydrabeam_mpi.report.chains.traces import draw_traces
from hydrabeam_mpi.report.chains.uncertainty import draw_spread, spread_of
from hydrabeam_mpi.report.page.parts import Answer, Section, part, together
from hydrabeam_mpi.report.page.style import Drawing
from hydrabeam_mpi.report.page.words import megahertz
from hydrabeam_mpi.sampling.status import Status
from hydrabeam_mpi.sampling.storage.store import ChainStore

Place = Callable[[Drawing], Markup]


def chains_page(store: ChainStore, status: Status, place: Place) -> tuple[Answer, list[Section]]:
    """Return what the page of chains begins with, and its sections.

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
    diagnosis, pooled = status.diagnosis, pool(store)
    spread = spread_of(pooled) if pooled else None
    picture = place(draw_spread(spread)) if spread else Markup()
    answer = Answer(_agreement(status), Markup(), picture, list(status.cautions))
    figures = map(place, _drawn(draw_ess(diagnosis), draw_traces(store, diagnosis)))
    mixing = together(mixing_rows(diagnosis), *figures, part("paragraph", str(status.held_out or "")))
    where = f", {megahertz(pooled.freq)}" if pooled and pooled.freq is not None else ""
    return answer, [
        Section("Do the chains agree?", mixing),
        Section(f"The beam and all else{where}", _beam(pooled, spread is not None, place) if pooled else Markup()),
        Section("All channels", channel_rows(store, status.diagnosis)),
        Section("How far they are", together(part("paragraph", introduction(store, status)), progress_rows(status))),
    ]


def _agreement(status: Status) -> str:
    """Say in a sentence whether the draws can be used."""
    if not status.diagnosis.chains:
        return "There are too few draws yet to say anything."
    if status.cautions:
        return "The draws are not yet to be relied on; the warnings say why."
    return "All chains agree: their draws are of the posterior."


def introduction(store: ChainStore, status: Status) -> str:
    """Tell in a paragraph what was drawn."""
    diagnosis = status.diagnosis
    blocks = ", ".join(one.block for one in diagnosis.blocks)
    text = f"Draws from the joint posterior of {blocks}: {diagnosis.n_draws} of each of {len(diagnosis.chains)} chains"
    text += f", after {store.warm_up} of warm-up that are left out." if store.warm_up else "."
    short = store.chains - len(diagnosis.chains)
    return text + (f" {short} more have not come half as far, and are left out." if short else "")


def _beam(pooled: Pooled, with_spread: bool, place: Place) -> Markup:
    """Return what the chains say of the beam, in the first channel."""
    directions, chance = directions_of(pooled)
    said = []
    if not with_spread and pooled.labels:
        said.append("There are too few draws to tell what part the other blocks have in the beam's uncertainty.")
    if not directions and pooled.labels:
        said.append("No direction in which the beam and the other blocks trade off is beyond chance.")
    drawn = map(place, _drawn(draw_directions(pooled, directions, chance)))
    return together(*drawn, *(part("paragraph", line) for line in said))


def _drawn(*drawings: Drawing | None) -> Iterator[Drawing]:
    return (one for one in drawings if one is not None)
