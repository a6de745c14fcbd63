"""Visibilities of baselines whose two antennas have different beams.

The power beam of a baseline is the product of its antennas' voltage beams. With their phases alike that of i and j is

    sqrt(B_i B_j) = (B_i + B_j) / 2 - (sqrt B_i - sqrt B_j)^2 / 2.

With D_i = sqrt B_i - sqrt B, the second part has a D_i^2 for each antenna, and D_i D_j for pairs of antennas that both
differ. The former are integrated for redundant groups; the latter, small of second order, as the products of antennas
that they are. So it is with what a further change of a beam does, dB_i / 2 - D_i d(sqrt B_i) + D_j d(sqrt B_i), the
last of which is a product of antennas where both differ.
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
    out = np.zeros(block.shape, dtype=complex)
    if not len(antennas):
        return out
    of_row = _places(block, antennas)[row_antennas(block)]
    both = np.flatnonzero((of_row >= 0).all(axis=1))
    positions = block.antpos[block.setup.antennas_in_use[antennas]]
    for t in range(len(block.times)):
        seen: list[tuple[Sources, FloatArray]] = []

        def single(sources: Sources, seen: list[tuple[Sources, FloatArray]] = seen) -> FloatArray:
            own = beams(sources)
            roots = _root(own) - _root(sources.beam)
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


def slopes_by_beams(
    block: RowBlock,
    antennas: IntArray,
    beams: Callable[[Sources], tuple[FloatArray, FloatArray]],
    common: Callable[[Sources], FloatArray],
) -> ComplexArray:
    """Return what further changes of its first and of its second antenna's beam add to each row.

    Parameters
    ----------
    block : RowBlock
    antennas : ndarray of int, (n,)
        As for `added_by_beams`.
    beams : callable
        From `Sources` to the power beams of these, (n, Nsrc), and to how they change, (n, k, Nsrc).
    common : callable
        From `Sources` to how the common power beam changes, (k, Nsrc).

    Returns
    -------
    ndarray of complex, (Ntimes, Nbls, 2, k)
        Jy.
    """
    n = len(antennas)
    of_row = _places(block, antennas)[row_antennas(block)]
    both = np.flatnonzero((of_row >= 0).all(axis=1))
    # What a row's side needs: an antenna that differs; the common beam beside such a one; or the common beam alone.
    of_side = np.where(of_row >= 0, of_row, np.where(of_row[:, ::-1] >= 0, n + of_row[:, ::-1], 2 * n))
    needed, of_side = np.unique(of_side, return_inverse=True)
    positions, values = block.antpos[block.setup.antennas_in_use[antennas]], []
    for t in range(len(block.times)):
        seen: list[tuple[Sources, FloatArray, FloatArray]] = []

        def single(sources: Sources, seen: list[tuple[Sources, FloatArray, FloatArray]] = seen) -> FloatArray:
            own, root, of_common = beams(sources), _root(sources.beam), common(sources)
            roots = _root(own[0])
            differences, of_roots = (roots - root)[:, np.newaxis], _slope_of_root(roots, own[1])
            seen.append((sources, differences[:, 0], of_roots))
            alone = 0.5 * own[1] - differences * of_roots
            beside = 0.5 * of_common + differences * _slope_of_root(root[np.newaxis], of_common[np.newaxis])
            functions = np.concatenate([alone, beside, 0.5 * of_common[np.newaxis]])
            return np.asarray(functions[needed].reshape(-1, functions.shape[-1]))

        integrals = replace(block, times=block.times[t : t + 1]).integrate(single)[0]
        value = integrals.reshape(len(block.groups), len(needed), -1)[block.member[:, np.newaxis], of_side]
        for sources, differences, of_roots in seen if len(both) else ():
            waves = plane_waves(positions, sources.enu, block.freq)
            others = amplitude(sources.flux_without()) * differences * waves
            value[both] += _further_of_pairs(of_row[both], waves, others, of_roots)
        values.append(value)
    return np.array(values)


def _further_of_pairs(of_row: IntArray, waves: ComplexArray, others: ComplexArray, slopes: FloatArray) -> ComplexArray:
    """Return what the product of one antenna's change and the other's difference adds to rows, (Nrows, 2, k).

    ``waves``, (n, Nsrc), and ``slopes``, (n, k, Nsrc), are of the antennas that differ, ``others``, (n, Nsrc), what
    these have with their waves and the fluxes; ``of_row``, (Nrows, 2), says which of them a row has.
    """
    out = np.zeros((*of_row.shape, slopes.shape[1]), dtype=complex)
    for antenna, (wave, slope) in enumerate(zip(waves, slopes, strict=True)):
        products = (slope * wave.conj()) @ others.T
        for side in range(2):
            mine = np.flatnonzero(of_row[:, side] == antenna)
            found = products[:, of_row[mine, 1 - side]].T
            out[mine, side] = found.conj() if side else found
    return out


def _places(block: RowBlock, antennas: IntArray) -> IntArray:
    """Return the number among some antennas of each in use, (Nants,); -1 for others."""
    place = np.full(len(block.setup.antennas_in_use), -1)
    place[antennas] = np.arange(len(antennas))
    return place


def _root(power: FloatArray) -> FloatArray:
    """Return the voltage beam; zero where the power beam is negative."""
    return np.asarray(np.sqrt(np.maximum(power, 0.0)))


def _slope_of_root(roots: FloatArray, changes: FloatArray) -> FloatArray:
    """Return how roots, (n, Nsrc), change as their powers do, (n, k, Nsrc); not at all where they are zero."""
    roots = roots[:, np.newaxis]
    return np.divide(0.5 * changes, roots, out=np.zeros_like(changes), where=roots > 0)
