"""Beams given effects of which some are seen by these beams: where a fit begins that knows the effects alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hydrabeam_mpi.fit.acceleration import EarlierSteps, in_sigmas_of
from hydrabeam_mpi.fit.beams_given import solve_beams
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.state import Estimate
from hydrabeam_mpi.fit.step import beam_moved


def with_own_beams(context: FitContext, at: Estimate, most: int, sigmas: float) -> Estimate:
    """Solve for beams and the E that they see in turns, with the effects where they are, until the beams are still.

    Where there are none they are solved for as if there were no effects: a step of these from there would lead away
    from what a job states. Where E, or C, depends much on the beams the turns by themselves go to and fro ever further;
    they learn from those before, as steps do. Collective: all ranks of the grid.

    Parameters
    ----------
    context : FitContext
    at : Estimate
        The effects, and beams to begin with where there are any.
    most : int
        Turns at most; the beams that moved least are returned.
    sigmas : float
        Where no channel's beam moves by more than this fraction of its standard deviation they are still.
    """
    at = at if at.beams else replace(at, beams=solve_beams(context, at).beams)
    if not at.values.adds:
        return at
    stillest, least, earlier = at, np.inf, EarlierSteps()
    for _ in range(most):
        beams = solve_beams(context, at).beams
        moved = beam_moved(context, at.beams, beams)
        if moved < least:
            stillest, least = replace(at, beams=beams), moved
        if moved < sigmas:
            break
        here = [beam.mean for beam in at.beams]
        step = [new.mean - old for old, new in zip(here, beams, strict=True)]
        earlier.add(here, step)
        if context.problem.coupling is None:
            in_sigmas = in_sigmas_of(context, beams)
            step = earlier.better_step(context.grid.world, in_sigmas, from_saddles=False) or step
        pairs = zip(beams, here, step, strict=True)
        at = replace(at, beams=tuple(replace(one, mean=old + further) for one, old, further in pairs))
    return stillest
