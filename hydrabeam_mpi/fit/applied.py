"""A fit applied to other data, none of which it has seen: what a rank's rows are expected to be, without fitting."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydrabeam_mpi.data.observation import FloatArray, IntArray
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.fit.carried_over import CarriedOver, carry_over, share_fit, untold
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.joint import find_setup
from hydrabeam_mpi.fit.rank_data import RankData
from hydrabeam_mpi.fit.same_antennas import check_places
from hydrabeam_mpi.fit.shares import read_share
from hydrabeam_mpi.fit.state import Fit, Fitted
from hydrabeam_mpi.io.inferred import Inferred
from hydrabeam_mpi.mpi import ProcessGrid, bcast_object, together
from hydrabeam_mpi.setup.problem import Problem

Array = NDArray[Any]


def apply_fit(
    grid: ProcessGrid, problem: Problem, result: Inferred | None
) -> tuple[Problem, FitContext, Fitted, CarriedOver]:
    """Return the model of a result for all rows of other data, as if they were held out from its fit.

    Channels count as the result's, whose numbers they get: laws in frequency refer to all of these.

    Collective: all ranks of the grid.

    Parameters
    ----------
    grid : ProcessGrid
    problem : Problem
        Of the other data, all channels; all rows to be fitted.
    result : Inferred, optional
        On rank 0, the only one that asks for it.

    Returns
    -------
    problem : Problem
        Of all channels of the other data, by their numbers in the result.
    context : FitContext
        All rows are both ``train`` and ``test``.
    fitted : Fitted
    carried : CarriedOver

    Raises
    ------
    InputError
        On all ranks, if the result cannot be applied to these data.
    """
    shared: tuple[Any, ...] = ()
    with together(grid.world):
        if result and grid.is_world_root:
            own, pol = result.content.polarization, problem.observation.pols[0]
            result = result.for_feed(pol)
            numbers = result.channels_in(problem.observation)
            with result.telling():
                setup = _setup_in(result, problem, numbers)
                assumed = f"assumed: the beam of {pol} is that of {own}, turned by 90 degrees" if result.turn else None
                found = carry_over(result.entries, setup, assumed)
            check_places(result, found, problem.observation, problem.job.data.redundancy_tol)
            shared = numbers, setup, found
    numbers, setup, carried = bcast_object(grid.world, shared)
    problem = replace(problem, basis=setup.basis, channel_numbers=numbers, test=problem.train)
    mine = problem.of_channels(grid.channels)
    parts, unknown = [], np.ones(sum(one.size for one in carried.values.active), dtype=bool)
    for place, number in enumerate(numbers.tolist()):
        part = share_fit(grid, result, carried, number)
        unknown &= untold(part[1], carried.values.prior_std(number))
        if place in grid.channels:
            parts.append(part)
    carried = carried.at_prior_too(setup, unknown)
    beams, covariances, responses = zip(*parts, strict=True)
    # Errors of the predictions of one time are whitened together.
    rows = RankData(mine, setup, read_share(grid, mine, mine.test, whole_times=True))
    has_effects = bool(carried.values.active)
    fit = Fit(beams, covariances, responses) if has_effects else Fit(beams)
    return problem, FitContext(grid, mine, setup, rows, rows), Fitted(carried.values, fit), carried


def _setup_in(result: Inferred, problem: Problem, numbers: IntArray) -> ObservingSetup:
    """Return what effects may know: of these data, but with the result's basis and channels.

    Nobody looks at the sky of channels that these data do not have.
    """
    observation = problem.observation
    freqs: FloatArray = np.array([record.freq for record in result.content.channels])
    places = np.zeros(len(freqs), dtype=int)
    places[numbers] = np.arange(len(numbers))
    widths = observation.channel_width[places]
    return replace(
        find_setup(problem),
        observation=replace(observation, freqs=freqs, channel_width=widths),
        sky=problem.sky.channels(places),
        basis=result.basis,
        prior_mean=result.model_means,
    )
