"""The size of the noise given all else.

With variances s / w, chi^2 = sum w |r|^2 of n complex data, and the prior p(s) ~ s^(-a-1) exp(-b/s),

    p(s | d, b, x)  ~  s^(-n) exp(-chi^2 / s) p(s):        an inverse gamma of shape a + n and scale b + chi^2.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hydrabeam_mpi.mpi import bcast_array
from hydrabeam_mpi.sampling.state import ChainState, Chance
from hydrabeam_mpi.sampling.walk import Walk


def draw_noise(walk: Walk, state: ChainState, chance: Chance) -> tuple[ChainState, dict[str, float]]:
    """Draw the scale of each channel's noise variance. Collective: the chain's ranks."""
    assert walk.noise is not None
    misfit, normals = walk.misfit(state.values, state.beams), walk.sums(state.values)
    drawn = [
        walk.noise.drawn_given(normal.n_data, chi2, chance.of("noise", channel))
        for normal, chi2, channel in zip(normals, misfit.tolist(), walk.channels, strict=True)
    ]
    return replace(state, noise=bcast_array(walk.context.grid.group, np.array(drawn))), {}
