"""Visibilities of baselines whose two antennas have different beams.

The power beam of a baseline is the product of its antennas' voltage beams. With their phases alike that of i and j is

    sqrt(B_i B_j) = (B_i + B_j) / 2 - (sqrt B_i - sqrt B_j)^2 / 2.

With D_i = sqrt B_i - sqrt B, the second part has a D_i^2 for each antenna, and D_i D_j for pairs of antennas that both
differ. The former are integrated for redundant groups; the latter, small of second order, as the products of antennas
that they are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.interface.sources import Sources
from hydrabeam_mpi.effects.shared.per_antenna import row_antennas
from hydrabeam_mpi.model.engines.base import amplitude
from hydrabeam_mpi.model.engines.fringes import plane_waves


def added_by_beams(block: RowBlock, antennas: IntArray, beams: Callable[[Sources], FloatArray]) -> ComplexArray:
    """Return what is added by antennas whose beams are not the common one, (Ntimes, Nbls), Jy.

    Parameters
    ----------
    block : RowBlock
    antennas : ndarray of int, (n,)
        Which of the antennas in use have beams of their own.
    beams : callable
        From `Sources` to the power beams of these, (n, Nsrc). Where beams are negative they count as zero in products.
    """
    setup = block.setup
    out = np.zeros(block.shape, dtype=complex)
    if not len(antennas):
        return out
    place = np.full(len(setup.antennas_in_use), -1)
    place[antennas] = np.arange(len(antennas))
    of_row = place[row_antennas(block)]
    both = np.flatnonzero((of_row >= 0).all(axis=1))
    positions = setup.observation.antpos[setup.antennas_in_use[antennas]]
    for t in range(len(block.times)):
        seen: list[tuple[Sources, FloatArray]] = []

        def single(sources: Sources, seen: list[tuple[Sources, FloatArray]] = seen) -> FloatArray:
            own = beams(sources)
            roots = np.sqrt(np.maximum(own, 0.0)) - np.sqrt(np.maximum(sources.beam, 0.0))
            seen.append((sources, roots))
            return np.asarray((own - sources.beam) - roots**2)

        changes = replace(block, times=block.times[t : t + 1]).integrate(single)[0, block.member]
        for side in range(2):
            rows = np.flatnonzero(of_row[:, side] >= 0)
            out[t, rows] += 0.5 * changes[rows, of_row[rows, side]]
        for sources, roots in seen if len(both) else ():
            voltages = roots * plane_waves(positions, sources.enu, block.freq)
            pairs = (voltages.conj() * amplitude(sources.flux_without())) @ voltages.T
            out[t, both] += pairs[of_row[both, 0], of_row[both, 1]]
    return out
