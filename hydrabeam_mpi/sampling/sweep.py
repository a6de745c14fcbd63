"""One pass over all steps."""

from __future__ import annotations

from hydrabeam_mpi.sampling.state import ChainState, Chance
from hydrabeam_mpi.sampling.steps.beam import draw_beams
from hydrabeam_mpi.sampling.steps.conditional import draw_effects_given_beams
from hydrabeam_mpi.sampling.steps.effect_width import draw_spreads
from hydrabeam_mpi.sampling.steps.effects import draw_effects
from hydrabeam_mpi.sampling.steps.noise import draw_noise
from hydrabeam_mpi.sampling.steps.prior_width import draw_widths
from hydrabeam_mpi.sampling.walk import Walk


def sweep(walk: Walk, state: ChainState, chance: Chance) -> tuple[ChainState, dict[str, float]]:
    """Pass over all steps, and tell which part of their proposals was accepted. Collective: the chain's ranks.

    Beams come right after effects that are drawn with the beams integrated out: the order matters for these. Weights of
    visibilities are drawn before all else, and so need not be known from one sweep to the next.
    """
    walk = walk.weighed(state, chance)
    steps = []
    if walk.unknowns.moving:
        steps.append(draw_effects if walk.collapsed else draw_effects_given_beams)
    steps.append(draw_beams)
    if walk.noise is not None:
        steps.append(draw_noise)
    if walk.widths is not None:
        steps.append(draw_widths)
    if walk.spreads is not None:
        steps.append(draw_spreads)
    accepted: dict[str, float] = {}
    for step in steps:
        state, told = step(walk, state, chance)
        accepted |= told
    return state, accepted
