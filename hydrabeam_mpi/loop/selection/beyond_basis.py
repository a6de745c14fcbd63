"""What no beam in the basis can follow is no finding: it belongs to the beam as soon as the data want it there."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import BrokenOff
from hydrabeam_mpi.fit.state import Active
from hydrabeam_mpi.loop.attribution.score_effects import attribute
from hydrabeam_mpi.loop.selection.acceptance import Candidate, Checked
from hydrabeam_mpi.loop.selection.folds import compared
from hydrabeam_mpi.loop.selection.heldout_score import gain_of
from hydrabeam_mpi.loop.selection.predictions import check
from hydrabeam_mpi.loop.selection.refits import fit_patiently
from hydrabeam_mpi.terminal.progress import say


class Beyond(NamedTuple):
    """How many functions beyond its basis a beam got, and their log Bayes factor."""

    n: int
    log_bayes_factor: float


NONE_BEYOND = Beyond(0, 0.0)


def with_functions_beyond(
    context: FitContext, checked: Checked, effects: Sequence[Effect], rivals: Sequence[Candidate]
) -> tuple[Checked, Beyond]:
    """Give the beam the functions beyond its basis that have the evidence, and more than any rival; return the fit.

    Functions that all vanish at the edge, as the paper's do, make up for a beam that does not by large coefficients of
    high orders, which no prior by the model's coefficients lets them have. That is known of the basis before there are
    data, and says nothing of the instrument. Held-out data must not be predicted worse. ``effects`` are those that are
    looked for, see `Effect.beyond_basis`. Collective: all ranks of the grid.
    """
    setup = context.setup
    beyond = [part for part in (effect.beyond_basis(setup) for effect in effects) if part is not None]
    if not beyond:
        return checked, NONE_BEYOND
    # A residual with structure is not noise, but a higher noise level seems to explain any residual.
    told = [one for one in rivals if one.finding is not None or one.is_of_bad_rows]
    others = [one.log_bayes_factor for one in told if not one.is_about_the_beam]
    least = max([context.problem.job.loop.min_log_bayes_factor, *others])
    if rivals and not any(one.log_bayes_factor >= least for one in rivals if one.is_about_the_beam):
        return checked, NONE_BEYOND
    return _with_one(context, checked, beyond, least)


def with_rest_of_model(context: FitContext, checked: Checked, effects: Sequence[Effect]) -> tuple[Checked, Beyond]:
    """Give the beam what its basis leaves of the model beam, where the data want that; return the fit.

    The model beam is known before there are data, so that this comes before anything is looked for: what a basis of
    few functions leaves of it, sources or gains would seem to explain. Collective: all ranks of the grid.
    """
    rests = [rest for rest in (effect.rest_of_model() for effect in effects) if rest is not None]
    least = context.problem.job.loop.min_log_bayes_factor
    return _with_one(context, checked, rests, least) if rests else (checked, NONE_BEYOND)


def _with_one(context: FitContext, checked: Checked, parts: Sequence[Effect], least: float) -> tuple[Checked, Beyond]:
    """Give the beam the best of some parts that has more than the ``least`` evidence, if held-out data are no worse."""
    for found in attribute(context, checked.fitted, parts):
        evidence = found.evidence
        if evidence.log_bayes_factor < least:
            continue
        start = Active.start(found.effect, context.setup, evidence.prior_var, evidence.x)
        try:
            after = check(context, fit_patiently(context, checked.fitted.values.extended(start), checked.fitted))
        except BrokenOff:
            continue
        one, two = compared(context, checked, after)
        gain = gain_of(one.score, two.score)
        numbers = f"ln BF {evidence.log_bayes_factor:.4g}, held-out ln density changes by {gain:.4g}"
        gets = f"the beam gets {start.size} function{'s' if start.size > 1 else ''} that its basis cannot follow"
        say(f"  {gets} ({numbers})", context.grid.is_world_root)
        if gain >= 0:
            return after, Beyond(start.size, evidence.log_bayes_factor)
    return checked, NONE_BEYOND
