"""The widths of the beams' prior given their coefficients.

A group of modes has the variances t sigma_n^2 about the model beam's coefficients m_n, and p(t) ~ t^(-a-1) exp(-b/t).
Of n complex coefficients

    p(t | b)  ~  t^(-n) exp(-sum |b_n - m_n|^2 / sigma_n^2 / t) p(t),

an inverse gamma; of real ones n and the sum count half.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.inference.prior import Prior
from hydrabeam_mpi.mpi import bcast_array
from hydrabeam_mpi.sampling.state import ChainState, Chance
from hydrabeam_mpi.sampling.walk import Walk


def draw_widths(walk: Walk, state: ChainState, chance: Chance) -> tuple[ChainState, dict[str, float]]:
    """Draw the scales of the prior's variances, by channel and group of modes. Collective: the chain's ranks."""
    assert walk.widths is not None
    numbers, drawn = np.bincount(walk.group_of), np.ones_like(state.widths)
    for f, (prior, beam) in enumerate(zip(walk.context.given(state.values).priors, state.beams, strict=True)):
        weight = 1.0 if np.iscomplexobj(beam) else 0.5
        power = weight * np.bincount(walk.group_of, _squares(prior, beam))
        for group, (number, total) in enumerate(zip(numbers.tolist(), power.tolist(), strict=True)):
            rng = chance.of("prior width", walk.channels[f], group)
            drawn[f, group] = walk.widths.drawn_given(weight * number, total, rng)
    return replace(state, widths=bcast_array(walk.context.grid.group, drawn)), {}


def _squares(prior: Prior, beam: Array) -> FloatArray:
    """Return |b_n - m_n|^2 / sigma_n^2, (n_modes,)."""
    return np.asarray(np.abs(beam - prior.mean) ** 2 / prior.std() ** 2)
