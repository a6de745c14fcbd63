"""What is found has to hold at the end, too, beside faults of the beam's model that would explain as much."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.state import Fitted
from hydrabeam_mpi.fit.step import solved_at
from hydrabeam_mpi.loop.attribution.reconsider import reconsider
from hydrabeam_mpi.loop.attribution.score_effects import Finding, attribute
from hydrabeam_mpi.loop.selection.acceptance import Candidate, Round
from hydrabeam_mpi.loop.selection.exchange import places_without
from hydrabeam_mpi.loop.selection.predictions import check
from hydrabeam_mpi.loop.selection.refits import fit_patiently
from hydrabeam_mpi.loop.selection.refusal import rivals_of
from hydrabeam_mpi.loop.selection.taken_back import Taken
from hydrabeam_mpi.loop.selection.trials import BesideRivals, least_beside
from hydrabeam_mpi.terminal.progress import say


def take_back_rivalled(context: FitContext, last: Round, n_given: int, faults: Sequence[Effect]) -> Taken:
    """Take back the effect that has the least evidence beside a fault of the beam's model, if that is too little.

    That was asked of every effect when it was found, beside the others of then. A beam that changes in time looks like
    many things at once, each of which may stand while the others take up the rest of it, or before these are found.
    Collective: all ranks of the grid.

    Parameters
    ----------
    context : FitContext
    last : Round
    n_given : int
        How many effects the job itself has in the model, which stay as they are.
    faults : sequence of Effect
        Modes that the basis lacks, and beams that change in time; none where nothing is asked.

    Returns
    -------
    last : Round
        Fitted without what was taken back.
    places : dict
        Where each active effect is now, by where it was; None where it was taken back.
    constancy : dict
        Empty.
    """
    fitted = last.after.fitted
    active = fitted.values.active
    asked = range(n_given, len(active)) if faults else ()
    beside = {place: _beside_rivals(context, fitted, place, faults) for place in asked}
    gone = min(beside, key=lambda place: beside[place].log_bayes_factor, default=-1)
    if not beside or beside[gone].refusal is None:
        return last, {place: place for place in range(len(active))}, {}
    told = f"{active[gone].effect.title}: taken back, as {beside[gone].refusal}"
    say(f"  {told}", context.grid.is_world_root)
    after = check(context, fit_patiently(context, fitted.values.without(gone), fitted))
    places = places_without(gone, len(active))
    del places[len(active)]
    return replace(last, after=after, revised=(*last.revised, told)), places, {}


def _beside_rivals(context: FitContext, fitted: Fitted, place: int, faults: Sequence[Effect]) -> BesideRivals:
    """Weigh an effect of the model beside what would explain as much in its place. Collective: all ranks."""
    own = Candidate.of(Finding(fitted.values.active[place].effect, reconsider(context, fitted, place)))
    # The beam stays: solved for without the effect it would be far from there, and any fault seem to explain much.
    without = solved_at(context, fitted.values.without(place), fitted, keep=True)
    ranking = list(map(Candidate.of, attribute(context, without, faults)))
    return least_beside(context, fitted, {place: rivals_of(own, ranking, context.problem.job.loop)})[place]
