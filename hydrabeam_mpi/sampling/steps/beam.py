"""The beams given all else: the posterior of the main job (HDBI II, eqs 10 to 14), of which one is drawn.

Where E or C is seen by the beam the draw is a proposal, from the Gaussian with those that the fit's beam sees, and a
channel's is accepted with the ratio of what the exact density has over that Gaussian to the same of the beam before.
Beams that are nowhere negative are drawn from the same Gaussian where they are so, which is reversible as well. Where
channels hang together all of them are accepted, or none.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hydrabeam_mpi.mpi import bcast_array, bcast_object
from hydrabeam_mpi.sampling.state import ChainState, Chance
from hydrabeam_mpi.sampling.walk import Walk


def draw_beams(walk: Walk, state: ChainState, chance: Chance) -> tuple[ChainState, dict[str, float]]:
    """Draw the beams given all else, and tell which part of the channels took theirs. Collective: the chain's ranks."""
    proposed = replace(state, beams=walk.drawn(walk.beams_given(state), chance, "beam", state.beams))
    if not walk.beam_is_seen:
        return proposed, {"beam": 1.0}
    gain = walk.log_correction(proposed) - walk.log_correction(state)
    if walk.hangs_together:
        rises = walk.context.over_channels(gain)
        all_taken = bcast_object(walk.context.grid.world, bool(np.log(chance.of("beam accepted").random()) < rises))
        return (proposed if all_taken else state), {"beam": float(all_taken)}
    chances = [chance.of("beam accepted", channel).random() for channel in walk.channels]
    taken = bcast_array(walk.context.grid.group, np.log(chances) < gain)
    pairs = zip(taken.tolist(), proposed.beams, state.beams, strict=True)
    part = walk.context.over_channels(taken.astype(float)) / walk.unknowns.n_freqs
    return replace(state, beams=tuple(new if yes else old for yes, new, old in pairs)), {"beam": part}
