"""All effects together with the beams integrated out.

The proposal is that of Crank and Nicolson about the Gaussian N(m, F F^T) of the joint fit (Cotter et al. 2013),

    y' = sqrt(1 - e^2) y + e k z,        x = m + F y,        z ~ N(0, 1),

reversible with respect to y ~ N(0, k^2). With e = 1 it does not depend on where the chain is: where the posterior is
nearly that Gaussian draws are nearly independent. It is accepted with the ratio of

    p(d | x, s, t) p(x) / N(y; 0, k^2)

there and here. Where E or C is seen by the beam, p(d | x) is that with what the fit's beams see; a beam is proposed
with x', from the Gaussian that belongs to it, and both are accepted together, with the exact density over that one as
a further factor. Else the beams that follow are drawn afresh by the step after this one, before anything else is drawn.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.mpi import bcast_array, bcast_object
from hydrabeam_mpi.sampling.state import ChainState, Chance
from hydrabeam_mpi.sampling.walk import Walk

TARGET = 0.4
"""Part of the proposals to be accepted where steps have to be shorter than whole ones: between the 0.23 that is best
in many dimensions and the 0.44 in one (Roberts and Rosenthal 2001); the loss around the best is small."""
FORGETS = 0.6
"""Power of the number of a sweep with which proposals learn less and less; between 1/2 and 1 for them to settle."""
LEAST_STEP = 1e-4
"""Steps are not shortened any more; a chain that wants that has other troubles."""


def draw_effects(walk: Walk, state: ChainState, chance: Chance) -> tuple[ChainState, dict[str, float]]:
    """Move all effects together, the beams integrated out. Collective: the chain's ranks."""
    here = log_ratio(walk, state)
    proposed = _proposed(walk, state, chance)
    try:
        if walk.beam_is_seen:
            proposed = replace(proposed, beams=walk.drawn(walk.beams_given(proposed), chance, "beam with effects"))
        there = log_ratio(walk, proposed)
    except InputError:
        # So far out that no beam can be solved for: of no probability.
        there = -np.inf
    rises = float(np.nan_to_num(there - here, nan=-np.inf))
    taken = bool(bcast_object(walk.context.grid.world, bool(np.log(chance.of("effects accepted").random()) < rises)))
    after = proposed if taken else state
    if chance.warming_up:
        after = _learnt(walk, after, min(1.0, float(np.exp(min(rises, 0.0)))), chance.sweep)
    return after, {"effects": float(taken)}


def log_ratio(walk: Walk, state: ChainState) -> float:
    """Return ln of the target over that of what proposals are reversible for. Collective: the chain's ranks."""
    given = walk.beams_given(state)
    white = _white(walk, state)
    about = 0.5 * float(white @ white) / state.scale**2
    told = walk.context.over_channels(given.log_evidence) + walk.context.over_channels(walk.log_correction(state))
    return told + walk.log_prior(state.values) + about


def _white(walk: Walk, state: ChainState) -> np.ndarray:
    return walk.proposal.white(walk.unknowns.vector(state.values))


def _proposed(walk: Walk, state: ChainState, chance: Chance) -> ChainState:
    """Return the state with effects as they are proposed, the same on all ranks. Collective: the chain's ranks."""
    white, length = _white(walk, state), state.step
    new = np.sqrt(1 - length**2) * white + length * state.scale * chance.of("effects").standard_normal(len(white))
    return replace(state, values=walk.unknowns.at(bcast_array(walk.context.grid.world, walk.proposal.vector(new))))


def _learnt(walk: Walk, state: ChainState, accepted: float, sweep: int) -> ChainState:
    """Return the state with proposals that are a little nearer to those wanted (Andrieu and Thoms 2008)."""
    pace = (sweep + 1.0) ** -FORGETS
    white = _white(walk, state)
    wider = float(white @ white) / (len(white) * state.scale**2)
    step = np.clip(state.step * np.exp(pace * (accepted - TARGET)), LEAST_STEP, 1.0)
    # Never narrower than the fit says: a Gaussian without the target's tails would leave chains stuck in these.
    scale = np.maximum(state.scale * np.exp(0.5 * pace * np.clip(wider - 1, -1, 1)), 1.0)
    return replace(state, step=float(step), scale=float(scale))
