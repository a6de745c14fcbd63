"""The beams given all else: the posterior of the main job (HDBI II, eqs 10 to 14), of which one is drawn.

Where E or C is seen by the beam the draw is a proposal, from the Gaussian with those that the fit's beam sees, and a
channel's is accepted with the ratio of what the exact density has over that Gaussian to the same of the beam before.
Beams that are nowhere negative are drawn from the same Gaussian where they are so, which is reversible as well.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hydrabeam_mpi.mpi import bcast_array
from hydrabeam_mpi.sampling.state import ChainState, Chance
from hydrabeam_mpi.sampling.walk import Walk


def draw_beams(walk: Walk, state: ChainState, chance: Chance) -> tuple[ChainState, dict[str, float]]:
    """Draw the beams given all else, and tell which part of the channels took theirs. Collective: the chain's ranks."""
    proposed = replace(state, beams=walk.drawn(walk.beams_given(state), chance, "beam", state.beams))
    if not walk.beam_is_seen:
        return proposed, {"beam": 1.0}
    gain = walk.log_correction(proposed) - walk.log_correction(state)
    chances = [chance.of("beam accepted", channel).random() for channel in walk.channels]
    taken = bcast_array(walk.context.grid.group, np.log(chances) < gain)
    pairs = zip(taken.tolist(), proposed.beams, state.beams, strict=True)
    part = walk.context.over_channels(taken.astype(float)) / walk.unknowns.n_freqs
    return replace(state, beams=tuple(new if yes else old for yes, new, old in pairs)), {"beam": part}
