"""Visibilities of the current beam on baseline vectors other than those of a block's groups."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hydrabeam_mpi.data.observation import Array, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.interface.sources import Sources
from hydrabeam_mpi.model.engines.base import amplitude
from hydrabeam_mpi.model.rime import Beam

VECTORS_AT_ONCE = 2048
"""Whose fringes are held together."""


def beam_visibilities(block: RowBlock, vectors: FloatArray) -> ComplexArray:
    """Integrate the current beam over the sky, once for a block.

    Parameters
    ----------
    block : RowBlock
        Keeps the result for as long as it has the same beam and times.
    vectors : ndarray, (N, 3)
        Baseline vectors, metres ENU; zero for autocorrelations.

    Returns
    -------
    ndarray of complex, (Ntimes, N)
        Jy.
    """
    kept: dict[bytes, tuple[Beam, IntArray, ComplexArray]] = vars(block).setdefault("_beam_visibilities", {})
    key = vectors.tobytes()
    if key in kept:
        beam, times, values = kept[key]
        if beam is block.beam and times is block.times:
            return values
    if vectors.any():
        integrals = block.integrate(lambda sources: sources.beam[np.newaxis], vectors)
    else:
        # There are no fringes.
        integrals = np.array([[_total_power(block, time)] * len(vectors) for time in block.times.tolist()])
    # Without times `integrals` has lost its axes.
    values = integrals.reshape(len(block.times), len(vectors)).astype(complex)
    kept[key] = block.beam, block.times, values
    return values


def by_real_unknowns(design: Array) -> ComplexArray:
    """Return the derivatives of visibilities by real unknowns, real parts of complex coefficients first.

    A design is (Ntimes, Ngroups, n) for complex coefficients, (Ntimes, 2, Ngroups, n) for real ones, and the result
    (Ntimes, Ngroups, 2 n) or (Ntimes, Ngroups, n).
    """
    if np.iscomplexobj(design):
        return np.asarray(np.concatenate([design, 1j * design], axis=-1))
    return np.asarray(design[:, 0] + 1j * design[:, 1])


def integrate_on(block: RowBlock, columns: Callable[[Sources], FloatArray], vectors: FloatArray) -> ComplexArray:
    """Integrate columns, (K, Nsrc), over the sky for many vectors, (N, 3), no two the same, in parts that fit.

    The result is (Ntimes, N, K); see `RowBlock.integrate`.
    """
    n_parts = -(-len(vectors) // VECTORS_AT_ONCE)
    parts = [block.integrate(columns, part) for part in np.array_split(vectors, n_parts)]
    return np.concatenate(parts, axis=1)


def _total_power(block: RowBlock, itime: int) -> float:
    """Return the autocorrelation of the sky, Jy."""
    parts = filter(None, (block.sources(itime), block.further_sources(itime)))
    return float(sum(amplitude(sources.flux_without()) @ sources.beam for sources in parts))
