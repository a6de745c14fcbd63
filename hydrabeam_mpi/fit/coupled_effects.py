"""Draws of beams that hang together over frequency, with the effects that were fitted with them."""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.data.observation import Array, BoolArray
from hydrabeam_mpi.fit.beams_given import sum_for_beams
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.coupled import CoupledChannel, solve_coupled
from hydrabeam_mpi.fit.coupled_step import JointStep, step_together
from hydrabeam_mpi.fit.grown import of_the_beam
from hydrabeam_mpi.fit.linearised import sums_at
from hydrabeam_mpi.fit.state import Fitted, Values
from hydrabeam_mpi.fit.whitening import root_of
from hydrabeam_mpi.inference.coupled import CoupledPosterior
from hydrabeam_mpi.mpi import share_by_channel, together
from hydrabeam_mpi.random import generator


def coupled_channels(context: FitContext, fitted: Fitted) -> list[CoupledChannel]:
    """Return what is kept of channels that hang together, with draws of beams and effects of all channels together.

    Collective: all ranks of the grid.

    Returns
    -------
    list of CoupledChannel
        Of the group's channels, on its root.
    """
    grid, values, n_draws = context.grid, fitted.values, context.problem.job.output.draws
    sums = sum_for_beams(context, fitted.estimate)
    solution = solve_coupled(grid, context.problem, sums.normals, n_draws)
    if not values.active:
        return solution.channels
    step = step_together(
        context, values, list(sums_at(context, fitted.estimate, sums.rows, sums.added, values)), solution.joint
    )
    records: list[tuple[Array, Array]] = []
    with together(grid.world):
        if step and solution.joint:
            more = of_the_beam(context.setup, values)
            records = _moves(step, solution.joint, values, more, context.problem.job.seed, n_draws)
    moves = share_by_channel(grid, records)
    found = []
    for one, prior, (moved, coeffs) in zip(solution.channels, context.problem.priors, moves, strict=False):
        draws = np.concatenate([one.draws + prior.std() * moved, coeffs], axis=1)
        found.append(CoupledChannel({}, draws, {**one.summary, "with_effects": True}))
    return found


def _moves(
    step: JointStep, beams: CoupledPosterior, values: Values, more: BoolArray, seed: int, n_draws: int
) -> list[tuple[Array, Array]]:
    """Draw the effects of all channels, and return for each by how much the beam follows, and coefficients among them.

    (n_draws, n) in units of the prior's widths, and (n_draws, n_more).
    """
    root = root_of(step.covariance)
    rngs = [generator(seed, "posterior draw of effects", draw) for draw in range(n_draws)]
    white = np.array([rng.standard_normal(root.shape[1]) for rng in rngs]).reshape(n_draws, root.shape[1])
    drawn, found = white @ root.T, []
    for channel, own in enumerate(drawn.reshape(n_draws, len(values.x), -1).swapaxes(0, 1)):
        follow = step.response_of(beams, channel)
        found.append((drawn @ follow.T, values.x[channel, more] + own[:, more]))
    return found
