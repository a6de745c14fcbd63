"""The size of the noise given all else.

With variances s / w, chi^2 = sum w |r|^2 of n complex data, and the prior p(s) ~ s^(-a-1) exp(-b/s),

    p(s | d, b, x)  ~  s^(-n) exp(-chi^2 / s) p(s):        an inverse gamma of shape a + n and scale b + chi^2.

Where antennas or lengths of baselines have scales of their own, each is drawn like that given the others: n and chi^2
are those of its baselines, chi^2 with the variances that the others make.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.fit.state import Estimate
from hydrabeam_mpi.mpi import allreduce_sum, bcast_array, together
from hydrabeam_mpi.sampling.noise import InverseGamma, NoiseParts, squared_residuals
from hydrabeam_mpi.sampling.state import ChainState, Chance
from hydrabeam_mpi.sampling.walk import Walk


def draw_noise(walk: Walk, state: ChainState, chance: Chance) -> tuple[ChainState, dict[str, float]]:
    """Draw the scales of each channel's noise variance. Collective: the chain's ranks."""
    assert walk.noise is not None
    if walk.parts is not None:
        return replace(state, parts=_drawn_parts(walk, walk.noise, walk.parts, state, chance)), {}
    misfit, normals = walk.misfit(state.values, state.beams), walk.sums(state.values)
    drawn = [
        walk.noise.drawn_given(normal.n_data, chi2, chance.of("noise", channel))
        for normal, chi2, channel in zip(normals, misfit.tolist(), walk.channels, strict=True)
    ]
    return replace(state, noise=bcast_array(walk.context.grid.group, np.array(drawn))), {}


def _drawn_parts(walk: Walk, prior: InverseGamma, parts: NoiseParts, state: ChainState, chance: Chance) -> FloatArray:
    """Draw the scale of each part of the noise given the others, one after the other, (Nlocal, n_parts)."""
    chi2, number = _by_baseline(walk, parts, state)
    drawn = state.parts.copy()
    for f, channel in enumerate(walk.channels):
        for part in range(drawn.shape[1]):
            of_it = np.any(parts.of_baseline == part, axis=0)
            others = parts.scale(drawn[f])[of_it] / drawn[f, part]
            rng = chance.of("noise", channel, part)
            drawn[f, part] = prior.drawn_given(number[f, of_it].sum(), float(np.sum(chi2[f, of_it] / others)), rng)
    return bcast_array(walk.context.grid.group, drawn)


def _by_baseline(walk: Walk, parts: NoiseParts, state: ChainState) -> FloatArray:
    """Return chi^2 by the stated noise, and the number of data, (2, Nlocal, Nbls) of the job's baselines.

    Collective: the chain's ranks.
    """
    grid, share = walk.context.grid, walk.context.train
    total = np.zeros((2, len(walk.channels), walk.context.setup.observation.Nbls))
    with together(grid.world):
        squares, weights = squared_residuals(share, Estimate(state.values, walk.as_posteriors(state.beams)))
        total[:, :, share.rows.tile.bls] = squares.sum(axis=1), np.count_nonzero(weights, axis=1)
    allreduce_sum(grid.group, total)
    # The walk's weights are by the scales as they are.
    total[0] *= parts.scale(state.parts)
    return total
