"""Cross-polarised rows, and what they say of the leakage between feeds."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.data.partition import Tile
from hydrabeam_mpi.effects.instrument.leakage import Leakage
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.fit.columns import Columns, RowSet
from hydrabeam_mpi.fit.equations import NormalEquations
from hydrabeam_mpi.fit.rows import read_rows
from hydrabeam_mpi.inference.gaussian import Block
from hydrabeam_mpi.inference.likelihood import Likelihood
from hydrabeam_mpi.mpi import ProcessGrid, allreduce_sum, together
from hydrabeam_mpi.setup.problem import Problem

MAX_NOISE = 0.05
"""Share of the regressors' noise in what is known of the leakage common to all antennas up to which it is believed."""


@dataclass(frozen=True)
class CrossRows:
    """Cross-polarised rows of one channel with their regressors, in the sense of the observation's antpairs.

    Attributes
    ----------
    channel : int
        Of all the job's channels.
    pol : str
    bls : ndarray of int, (Nbls,)
        Indices into the observation's baselines.
    data : ndarray of complex, (Ntimes, Nbls)
    weights : ndarray, (Ntimes, Nbls)
        Zero also where a co-polarised visibility is missing.
    measured, copols : dict of str to ndarray of complex, (Ntimes, Nbls)
        Co-polarised visibilities, and what is left of them without what has leaked into them.
    noise, power : float
        Sums of the regressors' variance and of their power, both weighted.
    """

    channel: int
    pol: str
    bls: IntArray
    data: ComplexArray
    weights: FloatArray
    measured: dict[str, ComplexArray]
    copols: dict[str, ComplexArray]
    noise: float
    power: float

    def without(self, check: Leakage, setup: ObservingSetup, x: FloatArray) -> CrossRows:
        """Return the rows with regressors from which D-terms have been taken, ``x`` being (n_params,)."""
        return replace(self, copols=check.without(setup, self.bls, self.measured, x))


@dataclass
class LeakageSums:
    """What all channels say of their D-terms, and scalars of each: number, sum w |d|^2, regressors' noise and power."""

    blocks: list[Likelihood]
    scalars: FloatArray


def read_cross(
    check: Leakage, grid: ProcessGrid, problem: Problem, setup: ObservingSetup, rows: Tile
) -> Iterator[CrossRows]:
    """Read a rank's share of some rows in all polarisations.

    Where the noise is estimated from differences, that of the job's polarisation stands for all.
    """
    tile = problem.tile_of(rows, grid.group.rank, grid.group.size)
    as_stored = replace(problem.redundant, flipped=np.zeros_like(problem.redundant.flipped))
    cross = check.cross_pols(setup)
    copols = check.copols(setup)
    parts = {}
    for pol in (*copols, *cross):
        observation = replace(problem.observation, pols=(pol,))
        parts[pol] = read_rows(replace(problem, observation=observation, redundant=as_stored), tile)
    for f, channel in enumerate(problem.channel_numbers.tolist()):
        measured = {pol: parts[pol].data[f] for pol in copols}
        known = [parts[pol].inv_noise_var[f] for pol in copols]
        usable = (known[0] > 0) & (known[1] > 0)
        variance = sum(np.where(usable, 1 / np.where(usable, weights, 1.0), 0.0) for weights in known)
        power = sum(np.abs(vis) ** 2 for vis in measured.values())
        for pol in cross:
            weights = np.where(usable, parts[pol].inv_noise_var[f], 0.0)
            sums = float(np.sum(weights * variance)), float(np.sum(weights * power))
            yield CrossRows(channel, pol, tile.bls, parts[pol].data[f], weights, measured, measured, *sums)


def sum_cross(grid: ProcessGrid, check: Leakage, setup: ObservingSetup, rows: list[CrossRows]) -> LeakageSums:
    """Accumulate normal equations over rows, polarisations and ranks. Collective: all ranks of `grid.world`.

    Without what they say of the common leakage where that is the regressors' noise, as for feeds with equal beams.
    """
    n_freqs, n = setup.observation.Nfreqs, len(check.parameters(setup))
    equations = [NormalEquations([Block(check.kind, n)]) for _ in range(n_freqs)]
    known = np.zeros((n_freqs, 2))
    with together(grid.world):
        for part in rows:
            total, weights = equations[part.channel], part.weights.reshape(-1)
            data = part.data.reshape(-1)
            of_rows = RowSet(weights * data, weights)
            matrix = check.columns(setup, part.pol, part.bls, part.copols).matrix()
            total.add_data(data, weights)
            total.add_rows({check.kind: Columns(of_rows, matrix, by_group=False)})
            known[part.channel] += part.noise, part.power
    for total in equations:
        total.reduce(grid.world)
    allreduce_sum(grid.world, known)
    common = check.degenerate_directions(setup)
    blocks = []
    for total, (noise, _) in zip(equations, known, strict=True):
        block = total.likelihood_alone([check.kind])
        told = np.trace(common @ block.information @ common.T)
        blocks.append(block.freed(common) if 4 * noise > MAX_NOISE * told else block)
    scalars = np.array([(total.n_data, total.data_norm, *own) for total, own in zip(equations, known, strict=True)])
    return LeakageSums(blocks, scalars)
