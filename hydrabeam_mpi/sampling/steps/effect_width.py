"""The widths of the effects' priors given their parameters, such as the power spectrum of diffuse emission.

The n parameters x of one thing, such as the harmonics of a degree, have the variances t sigma_n^2 about zero, and
p(t) ~ t^(-a-1) exp(-b/t), so that

    p(t | x)  ~  t^(-n/2) exp(-sum x_n^2 / sigma_n^2 / 2 t) p(t):        an inverse gamma.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hydrabeam_mpi.mpi import bcast_array
from hydrabeam_mpi.sampling.state import ChainState, Chance
from hydrabeam_mpi.sampling.walk import Walk


def draw_spreads(walk: Walk, state: ChainState, chance: Chance) -> tuple[ChainState, dict[str, float]]:
    """Draw the scales of the variances of effects' priors. Collective: the chain's ranks."""
    assert walk.spreads is not None
    squares, widths, _ = walk.unknowns.over_widths(walk.unknowns.vector(state.values))
    numbers, powers = np.bincount(widths), np.bincount(widths, squares)
    drawn = [
        walk.spreads.drawn_given(0.5 * number, 0.5 * power, chance.of("effect width", place))
        for place, (number, power) in enumerate(zip(numbers.tolist(), powers.tolist(), strict=True))
    ]
    return replace(state, spreads=bcast_array(walk.context.grid.world, np.array(drawn))), {}
