"""What one source on the sky would have in each integration: the brightest that is seen in what the model leaves.

A source that the catalogue lacks raises what is left of all baselines at once, as a bad integration does, as long as it
is up; but it is one direction.
"""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.data.observation import C_M_PER_S, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.loop.residuals.transients import TransientSums
from hydrabeam_mpi.mpi import ProcessGrid
from hydrabeam_mpi.setup.problem import Problem


def brightest_source(
    grid: ProcessGrid, problem: Problem, rows: tuple[IntArray, IntArray], weights: FloatArray, residual: ComplexArray
) -> ComplexArray:
    """Return the visibilities of the brightest source in the residual of each time, (Nlocal, Ntimes, Nbls).

    It has the same flux in all channels. Collective: all ranks of the grid.

    Parameters
    ----------
    grid : ProcessGrid
    problem : Problem
        Of all channels.
    rows : (ndarray of int, ndarray of int)
        This rank's channels, of all the job's, and baselines.
    weights : ndarray, (Nlocal, Ntimes, Nbls)
        Of what counts.
    residual : ndarray of complex, (Nlocal, Ntimes, Nbls)
        Jy.
    """
    (channels, bls), times = rows, np.arange(residual.shape[1])
    freqs = problem.observation.freqs
    groups, member = np.unique(problem.redundant.group[bls], return_inverse=True)
    vectors = problem.redundant.vectors
    sums = TransientSums.zeros(len(times), vectors, float(freqs.max()))
    root = np.sqrt(2 * weights)
    for channel, number in enumerate(channels):
        z = root[channel] * residual[channel]
        sums.add(times, z, root[channel], vectors[groups], member, float(freqs[number]))
    sums.reduce(grid.world)
    place = np.argmax(np.abs(sums.image), axis=1)
    flux = np.divide(sums.image[times, place], sums.weight, out=np.zeros(len(times)), where=sums.weight > 0)
    ahead = sums.directions[place] @ vectors[groups].T / C_M_PER_S
    phases = 2 * np.pi * freqs[channels][:, np.newaxis, np.newaxis] * ahead
    return np.asarray(flux[:, np.newaxis] * np.exp(1j * phases)[..., member])
