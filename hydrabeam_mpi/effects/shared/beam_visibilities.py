"""Visibilities of the current beam on baseline vectors other than those of a block's groups."""

from __future__ import annotations

import json
from collections.abc import Callable

import numpy as np

from hydrabeam_mpi.data.observation import Array, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.interface.sources import Sources
from hydrabeam_mpi.model.bases.base import LinearBasis
from hydrabeam_mpi.model.beam import CoefficientBeam
from hydrabeam_mpi.model.engines.base import amplitude
from hydrabeam_mpi.model.rime import Beam
from hydrabeam_mpi.model.tabulated import power_of

FEW = 512
"""Directions for which a table of the beam is not worth while: it has tens of thousands of nodes."""
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
        integrals = np.repeat(_total_power(block)[:, np.newaxis], len(vectors), axis=1)
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


def integrate_on(
    block: RowBlock, columns: Callable[[Sources], FloatArray], vectors: FloatArray, points: FloatArray
) -> ComplexArray:
    """Integrate columns, (K, Nsrc), over the sky for many vectors, (N, 3), no two the same, in parts that fit.

    Most of them may be differences of ``points``, (Npoints, 3). The result is (Ntimes, N, K); see `RowBlock.integrate`.
    """
    n_parts = -(-len(vectors) // VECTORS_AT_ONCE)
    engines = (block.engine_on(part, points) for part in np.array_split(vectors, n_parts))
    return np.concatenate([block.integrate(columns, engine=engine) for engine in engines], axis=1)


def _total_power(block: RowBlock) -> FloatArray:
    """Return the autocorrelation of the sky at each time, (Ntimes,), Jy."""
    power = []
    for time, known in zip(block.times.tolist(), _power_of_model(block), strict=True):
        sources, further = block.sources(time), block.further_sources(time)
        if known is None:
            of_model = amplitude(sources.flux_without()) @ sources.beam
        else:
            which, change = sources.changed
            of_model = known + amplitude(change) @ _power_of_some(block.beam, sources.za[which], sources.az[which])
        of_further = amplitude(further.flux) @ _power_of_some(block.beam, further.za, further.az) if further else 0.0
        power.append(of_model + of_further)
    return np.array(power)


def _power_of_some(beam: Beam, za: FloatArray, az: FloatArray) -> FloatArray:
    """Return the real part of a beam at some points, (Npoints,); of a few without its table, which takes far longer."""
    return power_of(beam, za, az) if len(za) > FEW else np.asarray(beam(za, az)).real


def _power_of_model(block: RowBlock) -> list[float | None]:
    """Return the autocorrelation of the sky model as it is at each time, Jy, where that takes no pass over the sky.

    What the functions of a beam see of it is kept, once another beam asks for the same: a fit asks at every step.
    """
    times, beam = block.times.tolist(), block.beam
    if block.memo is None or not isinstance(beam, CoefficientBeam):
        return [None] * len(times)
    name = f"total power by {json.dumps(beam.basis.describe())}"
    kept, asked = block.memo.setdefault((block.channel, name), ({}, {}))
    kept.update(
        {time: _seen_by_columns(block, beam.basis, time) for time in times if time in asked and time not in kept}
    )
    asked.update(dict.fromkeys(times, (b"", np.zeros(0))))
    return [float((beam.basis.mix(kept[time]) @ beam.coeffs).real) if time in kept else None for time in times]


def _seen_by_columns(block: RowBlock, basis: LinearBasis, itime: int) -> FloatArray:
    """Return what the columns of a basis see of the sky model at a time, (n_columns,), Jy."""
    sources, freqs = block.sources(itime), np.array([block.freq])
    engine = block.engine_on(np.zeros((1, 3)))
    return engine.design(basis, sources.za, sources.az, sources.flux[np.newaxis], freqs)[0, 0, 0]
