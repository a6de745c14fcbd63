"""A few rows of a job with made-up visibilities, on which its own steps are timed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hydrabeam_mpi.config.simulation import Perturbation
from hydrabeam_mpi.data.observation import IntArray
from hydrabeam_mpi.data.partition import Tile
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.joint import setup_of
from hydrabeam_mpi.fit.rank_data import RankData
from hydrabeam_mpi.fit.rows import Rows
from hydrabeam_mpi.model.beam import Beam
from hydrabeam_mpi.mpi import ProcessGrid, alone
from hydrabeam_mpi.random import complex_normal, generator
from hydrabeam_mpi.setup.beams import perturb
from hydrabeam_mpi.setup.problem import Problem

TOO_LARGE = 1.05
"""By how much the visibilities of one antenna are too large, so that there is something for a loop to find."""
SIGNAL_TO_NOISE = 1000.0


def probe(
    problem: Problem, n_times: int, n_groups: int, beams: Sequence[Beam] | None = None, faulty: bool = True
) -> FitContext:
    """Return some rows of a problem, with visibilities of a beam and noise. Serial.

    Parameters
    ----------
    problem : Problem
    n_times, n_groups : int
        How many times and redundant groups, evenly spread over those that there are; as many held out.
    beams : sequence of callable, optional
        That of each channel; the model beams by default.
    faulty : bool
        Whether one antenna's visibilities are too large.
    """
    groups = _spread(problem.redundant.Ngroups, n_groups)
    bls = np.flatnonzero(np.isin(problem.redundant.group, groups))
    train, test = (
        Tile(rows.times[_spread(len(rows.times), n_times)], np.intersect1d(rows.bls, bls))
        for rows in (problem.train, problem.test)
    )
    # Effects have the parameters that they have in the run: their number hangs on all times.
    setup = setup_of(problem, problem.observation.pols)
    problem = replace(problem, train=train, test=test)
    beams, one_antenna = beams or problem.beams, TOO_LARGE if faulty else 1.0
    own = [RankData(problem, setup, _rows(problem, tile, beams, one_antenna)) for tile in (train, test)]
    return FitContext(ProcessGrid.split(alone(), problem.observation.Nfreqs), problem, setup, own[0], own[1])


def _spread(n: int, wanted: int) -> IntArray:
    """Return ``wanted`` of ``n`` indices, evenly spread, or all of them."""
    return np.unique(np.linspace(0, n - 1, min(n, wanted)).round().astype(int)) if n else np.zeros(0, dtype=int)


def departing(problem: Problem) -> list[Beam]:
    """Return beams that differ from the model beams as those of a simulation do: of the job's own, if it has one.

    How long widths of the beam's prior are looked for hangs on what these have to make up for.
    """
    simulated = problem.job.data.simulate
    settings = simulated.perturb if simulated is not None else Perturbation()
    return [beam if settings is None else perturb(problem.job, beam, settings) for beam in problem.beams]


def _rows(problem: Problem, tile: Tile, beams: Sequence[Beam], one_antenna: float) -> Rows:
    """Make up the visibilities of a tile; those of one antenna are too large by a factor."""
    groups, member = np.unique(problem.redundant.group[tile.bls], return_inverse=True)
    signal = problem.forward_model(groups).visibilities(beams, tile.times)[:, :, member]
    # Noise follows the sky's power, as a receiver's does: else bright times would have all the evidence.
    sigma = np.sqrt(np.mean(np.abs(signal) ** 2, axis=-1, keepdims=True)) / SIGNAL_TO_NOISE if signal.size else 1.0
    observation = problem.observation
    of_one = np.any(observation.antpairs[tile.bls] == observation.antenna_numbers[observation.Nants // 2], axis=1)
    noise = sigma * complex_normal(generator(0, "plan", len(tile.times)), signal.shape)
    data = signal * np.where(of_one, one_antenna, 1.0) + noise
    return Rows(tile, data, np.broadcast_to(sigma**-2.0, data.shape).copy(), groups, member, data.size)
