"""What no beam in the basis can follow is no finding: it belongs to the beam as soon as the data want it there."""

from __future__ import annotations

from collections.abc import Sequence

from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.state import Active
from hydrabeam_mpi.loop.attribution.candidate_rows import CachedRowBlocks
from hydrabeam_mpi.loop.attribution.score_effects import attribute
from hydrabeam_mpi.loop.selection.acceptance import Checked
from hydrabeam_mpi.loop.selection.folds import compared
from hydrabeam_mpi.loop.selection.heldout_score import gain_of
from hydrabeam_mpi.loop.selection.predictions import check
from hydrabeam_mpi.loop.selection.refits import fit_patiently
from hydrabeam_mpi.mpi import together
from hydrabeam_mpi.terminal.progress import say


def with_functions_beyond(context: FitContext, checked: Checked, effects: Sequence[Effect]) -> tuple[Checked, int]:
    """Give the beam the functions beyond its basis that have the evidence; return the fit, and how many they are.

    Functions that all vanish at the edge, as the paper's do, make up for a beam that does not by large coefficients of
    high orders, which a prior that is as narrow as the data want does not let them have. Held-out data must not be
    predicted worse. ``effects`` are those that are looked for, see `Effect.beyond_basis`. Collective: all ranks of the
    grid.
    """
    setup, least = context.setup, context.problem.job.loop.min_log_bayes_factor
    beyond = [part for part in (effect.beyond_basis(setup) for effect in effects) if part is not None]
    if not beyond:
        return checked, 0
    with together(context.grid.world):
        cached = CachedRowBlocks.of(context, checked.fitted.estimate)
    for found in attribute(context, checked.fitted, beyond, cached):
        evidence = found.evidence
        if evidence.log_bayes_factor < least:
            continue
        start = Active.start(found.effect, setup, evidence.prior_var, evidence.x)
        after = check(context, fit_patiently(context, checked.fitted.values.extended(start), checked.fitted))
        one, two = compared(context, checked, after)
        gain = gain_of(one.score, two.score)
        told = f"{start.size} functions that the basis cannot follow belong to the beam"
        numbers = f"ln BF {evidence.log_bayes_factor:.4g}, held-out ln density changes by {gain:.4g}"
        say(f"    {told} ({numbers}{'; refused' if gain < 0 else ''})", context.grid.is_world_root)
        if gain >= 0:
            return after, start.size
    return checked, 0
