"""Beams of channels that hang together over frequency in a chain: all of them given all else, as one Gaussian.

The target is that of `hydrabeam_mpi.sampling.walk` with the prior p(b | x) of all channels together. So the evidence
p(d | x, s) is that of all channels, effects of single channels are not independent of each other given the others, and
a proposal of the beams is accepted in all channels or in none.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydrabeam_mpi.data.observation import Array
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.coupled import assemble, told_of
from hydrabeam_mpi.fit.equations import NormalEquations
from hydrabeam_mpi.inference.coupled import CoupledPosterior
from hydrabeam_mpi.inference.prior import Prior
from hydrabeam_mpi.mpi import bcast_array, share_by_channel, together


def solve_together(
    context: FitContext, normals: Sequence[NormalEquations], priors: Sequence[Prior]
) -> tuple[CoupledPosterior | None, float]:
    """Return the beams given all else, on rank 0, and ln of the evidence, on all ranks. Collective: the chain's ranks.

    Parameters
    ----------
    context : FitContext
    normals : sequence of NormalEquations
        Of the group's channels, by the noise as it is drawn; on the group's root.
    priors : sequence of Prior
        Of these channels.
    """
    grid, coupling = context.grid, context.problem.coupling
    assert coupling is not None
    with together(grid.world):
        told = [told_of(normal, prior) for normal, prior in zip(normals, priors, strict=False)]
    joint = assemble(grid, context.problem, coupling.candidates[0], told)
    return joint, float(grid.world.bcast(joint.joint.log_evidence if joint else None))


def draw_together(
    context: FitContext, joint: CoupledPosterior | None, rng: np.random.Generator, priors: Sequence[Prior]
) -> tuple[Array, ...]:
    """Draw the beams of all channels; return those of the group. Collective: the chain's ranks."""
    away: Sequence[Array] = ()
    with together(context.grid.world):
        if joint is not None:
            away = list(np.tensordot(joint.modes, joint.joint.draw(rng).reshape(-1, joint.n), 1))
    mine = share_by_channel(context.grid, away)
    found = []
    for f, prior in enumerate(priors):
        beam = prior.mean + prior.std() * mine[f] if mine else None
        found.append(bcast_array(context.grid.group, beam))
    return tuple(found)
