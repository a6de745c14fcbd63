"""A few rows of a job with made-up visibilities, on which its own steps are timed."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from hydrabeam_mpi.data.observation import IntArray
from hydrabeam_mpi.data.partition import Tile
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.rank_data import RankData
from hydrabeam_mpi.fit.rows import Rows
from hydrabeam_mpi.mpi import ProcessGrid, alone
from hydrabeam_mpi.random import complex_normal, generator
from hydrabeam_mpi.setup.problem import Problem
from hydrabeam_mpi.setup.skies import source_positions

TOO_LARGE = 1.05
"""By how much the visibilities of one antenna are too large, so that there is something for a loop to find."""
SIGNAL_TO_NOISE = 1000.0


def probe(problem: Problem, n_times: int, n_groups: int) -> FitContext:
    """Return some rows of a problem of one channel, with visibilities of its model beam and noise. Serial.

    Parameters
    ----------
    problem : Problem
    n_times, n_groups : int
        How many times and redundant groups, evenly spread over those that there are; as many held out.
    """
    groups = _spread(problem.redundant.Ngroups, n_groups)
    bls = np.flatnonzero(np.isin(problem.redundant.group, groups))
    train, test = (
        Tile(rows.times[_spread(len(rows.times), n_times)], np.intersect1d(rows.bls, bls))
        for rows in (problem.train, problem.test)
    )
    # Effects have the parameters that they have in the run: their number hangs on all times.
    fitted, in_use = problem.train.times, np.union1d(problem.train.times, problem.test.times)
    problem = replace(problem, train=train, test=test)
    setup = ObservingSetup(
        observation=problem.observation,
        redundant=problem.redundant,
        sky=problem.sky,
        basis=problem.basis,
        prior_mean=problem.model_means,
        file_pols=problem.observation.pols,
        times=in_use,
        positions=partial(source_positions, problem.job),
        fitted=fitted,
    )
    own = [RankData(problem, setup, _rows(problem, tile)) for tile in (train, test)]
    return FitContext(ProcessGrid.split(alone(), 1), problem, setup, own[0], own[1])


def _spread(n: int, wanted: int) -> IntArray:
    """Return ``wanted`` of ``n`` indices, evenly spread, or all of them."""
    return np.unique(np.linspace(0, n - 1, min(n, wanted)).round().astype(int)) if n else np.zeros(0, dtype=int)


def _rows(problem: Problem, tile: Tile) -> Rows:
    """Make up the visibilities of a tile."""
    groups, member = np.unique(problem.redundant.group[tile.bls], return_inverse=True)
    signal = problem.forward_model(groups).visibilities(problem.beams, tile.times)[:, :, member]
    sigma = np.sqrt(np.mean(np.abs(signal) ** 2)) / SIGNAL_TO_NOISE if signal.size else 1.0
    observation = problem.observation
    of_one = np.any(observation.antpairs[tile.bls] == observation.antenna_numbers[observation.Nants // 2], axis=1)
    noise = sigma * complex_normal(generator(0, "plan", len(tile.times)), signal.shape)
    data = signal * np.where(of_one, TOO_LARGE, 1.0) + noise
    return Rows(tile, data, np.full(data.shape, sigma**-2), groups, member, data.size)
