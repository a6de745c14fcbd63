"""Effects with the beams integrated out.

The proposal is that of Crank and Nicolson about the Gaussian N(m, F F^T) of the joint fit (Cotter et al. 2013),

    y' = sqrt(1 - e^2) y + e k z,        x = m + F y,        z ~ N(0, 1),

reversible with respect to y ~ N(0, k^2). With e = 1 it does not depend on where the chain is: where the posterior is
nearly that Gaussian draws are nearly independent. It is accepted with the ratio of

    p(d | x, s, t) p(x) / N(y; 0, k^2)

there and here. Where E or C is seen by the beam, p(d | x) is that with what the fit's beams see; a beam is proposed
with x', from the Gaussian that belongs to it, and both are accepted together, with the exact density over that one as
a further factor. Else the beams that follow are drawn afresh by the step after this one, before anything else is drawn.

Beams that may not be negative go with x' instead: as far from what x' expects of them as they were from what x did,
w = L^H (b - m). In (x, w) the target is p(d | x) p(x) N(w; 0, 1) where b(x, w) is nowhere negative, and zero elsewhere.

The numbers y are ordered such that those of a channel alone, with F the inverse of a Cholesky factor, change the
parameters of that channel alone, and the numbers y of what channels have in common change these and take those of all
channels with them, as far as they depend on each other. Given the latter the posterior factorises: all channels are
moved at once and each is accepted by its own data. What they have in common is moved after that, by the data of all.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hydrabeam_mpi.data.observation import BoolArray, FloatArray, IntArray
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.mpi import bcast_array, bcast_object, gather_by_channel
from hydrabeam_mpi.sampling.state import ChainState, Chance
from hydrabeam_mpi.sampling.walk import Walk

TARGET = 0.4
"""Part of the proposals to be accepted where steps have to be shorter than whole ones: between the 0.23 that is best
in many dimensions and the 0.44 in one (Roberts and Rosenthal 2001); the loss around the best is small."""
FORGETS = 0.6
"""Power of the number of a sweep with which proposals learn less and less; between 1/2 and 1 for them to settle."""
SHORT = 0.3
"""Every second step is so much shorter than the one before: a chain that has come into a tail, from where hardly any
whole step is accepted, walks out of it."""
LEAST_STEP = 1e-4
"""Steps are not shortened any more; a chain that wants that has other troubles."""


def draw_effects(walk: Walk, state: ChainState, chance: Chance) -> tuple[ChainState, dict[str, float]]:
    """Move effects, those of single channels first, the beams integrated out. Collective: the chain's ranks."""
    accepted, n_freqs = [], walk.unknowns.n_freqs
    if walk.unknowns.channel_of_free[0] < n_freqs:
        state, taken = _moved(walk, state, chance, np.arange(n_freqs))
        accepted.append(taken)
    if walk.unknowns.channel_of_free[-1] == n_freqs:
        state, taken = _moved(walk, state, chance, np.array([n_freqs]))
        accepted.append(taken)
    return state, {"effects": float(np.mean([np.mean(taken) for taken in accepted]))}


def _moved(walk: Walk, state: ChainState, chance: Chance, groups: IntArray) -> tuple[ChainState, BoolArray]:
    """Move the numbers y of each of some channels, or those of several together, and tell which were accepted.

    Collective: the chain's ranks.
    """
    here = log_ratio(walk, state, len(groups))
    proposed = _proposed(walk, state, chance, groups)
    try:
        if walk.positive is not None:
            proposed = replace(proposed, beams=walk.carried(state, proposed))
        elif walk.beam_is_seen:
            purpose = f"beam with effects of {groups[0]}"
            proposed = replace(proposed, beams=walk.drawn(walk.beams_given(proposed), chance, purpose))
        rises = np.nan_to_num(log_ratio(walk, proposed, len(groups)) - here, nan=-np.inf)
    except InputError:
        # So far out that no beam can be solved for: of no probability.
        rises = np.full(len(groups), -np.inf)
    draws = [chance.of("effects accepted", group).random() for group in groups.tolist()]
    taken: BoolArray = bcast_object(walk.context.grid.world, np.log(draws) < rises)
    after = _where_taken(walk, taken, proposed, state)
    if chance.warming_up and not chance.sweep % 2:
        after = _learnt(walk, after, groups, np.exp(np.minimum(rises, 0.0)), chance.sweep)
    return after, taken


def log_ratio(walk: Walk, state: ChainState, n_groups: int) -> FloatArray:
    """Return ln of the target over that of what proposals are reversible for, (n_groups,).

    That of all channels is a single number; with ``n_groups`` channels each has its own, up to what they have in
    common. Collective: the chain's ranks.
    """
    grid, unknowns = walk.context.grid, walk.unknowns
    told = walk.beams_given(state).log_evidence + walk.log_correction(state)
    about = 0.5 * (_white(walk, state) / state.scale[unknowns.channel_of_free]) ** 2
    if n_groups == 1:
        return np.array([walk.context.over_channels(told) + walk.log_prior(state) + about.sum()])
    told = bcast_object(grid.world, np.array(gather_by_channel(grid, told.tolist() if grid.is_group_root else [])))
    of_each = np.bincount(unknowns.channel_of_free, about, n_groups + 1)[:-1]
    of_widths = unknowns.log_prior_of_widths(state.values, state.spreads)[:-1]
    return np.asarray(told + unknowns.log_prior_apart(state.values) + of_widths + of_each)


def _white(walk: Walk, state: ChainState) -> FloatArray:
    return walk.proposal.white(walk.unknowns.vector(state.values))


def _proposed(walk: Walk, state: ChainState, chance: Chance, groups: IntArray) -> ChainState:
    """Return the state with effects as they are proposed, the same on all ranks. Collective: the chain's ranks."""
    channel_of, unknowns, before = walk.unknowns.channel_of_free, walk.unknowns, walk.unknowns.vector(state.values)
    white, length, scale = _white(walk, state), state.step[channel_of], state.scale[channel_of]
    if chance.sweep % 2:
        length = SHORT * length
    new = np.sqrt(1 - length**2) * white + length * scale * chance.of("effects").standard_normal(len(white))
    vector = walk.proposal.vector(np.where(np.isin(channel_of, groups), new, white))
    if len(groups) > 1:
        # What channels have in common stays as it is, to the last digit.
        vector = unknowns.taken(np.ones(len(groups), dtype=bool), vector, before)
    return replace(state, values=unknowns.at(bcast_array(walk.context.grid.world, vector)))


def _where_taken(walk: Walk, taken: BoolArray, proposed: ChainState, state: ChainState) -> ChainState:
    """Return the state with what is proposed where it is accepted. Collective: the chain's ranks."""
    if taken.all():
        return proposed
    if not taken.any():
        return state
    unknowns, mine = walk.unknowns, taken[walk.channels]
    vector = unknowns.taken(taken, unknowns.vector(proposed.values), unknowns.vector(state.values))
    pairs = zip(mine.tolist(), proposed.beams, state.beams, strict=True)
    after = replace(state, values=unknowns.at(vector), beams=tuple(new if yes else old for yes, new, old in pairs))
    walk.mixed(mine, proposed, state, after)
    return after


def _learnt(walk: Walk, state: ChainState, groups: IntArray, accepted: FloatArray, sweep: int) -> ChainState:
    """Return the state with proposals that are a little nearer to those wanted (Andrieu and Thoms 2008)."""
    pace, channel_of = (sweep + 1.0) ** -FORGETS, walk.unknowns.channel_of_free
    size = len(state.step)
    power = np.bincount(channel_of, _white(walk, state) ** 2, size) / np.maximum(np.bincount(channel_of, None, size), 1)
    step, scale = state.step.copy(), state.scale.copy()
    wider = power[groups] / scale[groups] ** 2
    step[groups] = np.clip(step[groups] * np.exp(pace * (accepted - TARGET)), LEAST_STEP, 1.0)
    # Never narrower than the fit says: a Gaussian without the target's tails would leave chains stuck in these.
    scale[groups] = np.maximum(scale[groups] * np.exp(0.5 * pace * np.clip(wider - 1, -1, 1)), 1.0)
    return replace(state, step=step, scale=scale)
