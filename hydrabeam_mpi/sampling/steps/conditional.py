"""All effects together given the beams: plain Gibbs, to compare with `effects`.

The model linearised at the effects x has a Gaussian posterior given the beams, N(x + m(x), J(x)^-1), of which one is
drawn; what is not linear is corrected by Metropolis and Hastings' ratio with the Gaussian of the way back. Where beams
and effects are degenerate a chain walks slowly: each can move only as far as the other lets it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.fit.linearised import active_sums
from hydrabeam_mpi.fit.state import Estimate
from hydrabeam_mpi.mpi import bcast_array, bcast_object, gather_by_channel, together
from hydrabeam_mpi.sampling.state import ChainState, Chance
from hydrabeam_mpi.sampling.walk import Walk


@dataclass(frozen=True)
class _Gaussian:
    """Where steps in the free directions lead to: mean (n_free,) and the factor of the precision (n_free, n_free)."""

    mean: FloatArray
    factor: FloatArray

    def draw(self, rng: np.random.Generator) -> FloatArray:
        white = rng.standard_normal(len(self.mean))
        return np.asarray(self.mean + solve_triangular(self.factor, white, lower=True, trans="T", check_finite=False))

    def log_density(self, step: FloatArray) -> float:
        away = self.factor.T @ (step - self.mean)
        return float(np.sum(np.log(np.diag(self.factor))) - 0.5 * away @ away)


def draw_effects_given_beams(walk: Walk, state: ChainState, chance: Chance) -> tuple[ChainState, dict[str, float]]:
    """Move all effects together given the beams. Collective: the chain's ranks."""
    world = walk.context.grid.world
    here = _given_beams(walk, state)
    vector, step = walk.unknowns.vector(state.values), None
    with together(world):
        if here is not None:
            step = here.draw(chance.of("effects"))
    step = bcast_array(world, step)
    proposed = replace(state, values=walk.unknowns.at(bcast_array(world, vector + walk.unknowns.free @ step)))
    rises = _log_target(walk, proposed) - _log_target(walk, state)
    try:
        there = _given_beams(walk, proposed)
    except InputError:
        # Nothing leads back from there.
        return state, {"effects": 0.0}
    if here is not None and there is not None:
        rises += there.log_density(-step) - here.log_density(step)
    taken = bool(bcast_object(world, bool(np.log(chance.of("effects accepted").random()) < rises)))
    return (proposed if taken else state), {"effects": float(taken)}


def _given_beams(walk: Walk, state: ChainState) -> _Gaussian | None:
    """Return what the model linearised here says of the effects, on rank 0. Collective: the chain's ranks."""
    context, values = walk.context, state.values
    at = Estimate(values, walk.as_posteriors(state.beams))
    with together(context.grid.world):
        rows, added = context.train.calibrated(at)
    likelihoods = []
    for f in range(len(state.beams)):
        sums = active_sums(context, context.train, at, f, rows, added[f], values.blocks)
        likelihoods.append(sums.likelihood_alone(list(values.blocks)))
    is_root = context.grid.is_group_root
    gathered = gather_by_channel(context.grid, list(zip(likelihoods, state.noise, strict=True)) if is_root else [])
    found = None
    with together(context.grid.world):
        if gathered:
            by_channel, noise = zip(*gathered, strict=True)
            found = _Gaussian(*walk.unknowns.posterior(walk.unknowns.vector(values), by_channel, np.array(noise)))
    return found


def _log_target(walk: Walk, state: ChainState) -> float:
    """Return ln p(d | b, x, s) p(b | x) p(x) up to what the effects do not change. Collective: the chain's ranks."""
    told = walk.log_prior_of_beams(state) - walk.misfit(state.values, state.beams) / state.noise
    return walk.context.over_channels(told) + walk.log_prior(state)
