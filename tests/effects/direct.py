"""The visibilities of a small scene by plain sums over sources, with directions, beams and vectors of one's own."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.model.engines.fringes import enu

C = 299792458.0
BeamOfDirection = Callable[[FloatArray], FloatArray]


def unit_vectors(block: RowBlock, itime: int) -> FloatArray:
    """Directions of the sources above the horizon, (3, Nsrc)."""
    _, za, az = block.positions.above_horizon(itime)
    return np.stack([np.sin(za) * np.cos(az), np.sin(za) * np.sin(az), np.cos(za)])


def of_direction(block: RowBlock) -> BeamOfDirection:
    """The scene's beam as a function of unit vectors, at most at the horizon."""

    def beam(vectors: FloatArray) -> FloatArray:
        east, north, up = vectors
        return np.asarray(block.beam(np.arccos(np.clip(up, 0, 1)), np.arctan2(north, east))).real

    return beam


def row_vectors(block: RowBlock) -> FloatArray:
    """Vectors from the antennas' positions in the sense of the groups, (Nbls, 3)."""
    antpos = block.setup.observation.antpos
    return antpos[block.ant2] - antpos[block.ant1]


def visibilities(
    block: RowBlock,
    vectors: FloatArray | None = None,
    turn: Callable[[FloatArray, int], FloatArray] = lambda directions, itime: directions,
    beam: Callable[[FloatArray, int], FloatArray] | None = None,
) -> ComplexArray:
    """Sum over the sources, (Ntimes, Nbls).

    ``turn`` moves the directions of a time; ``beam`` gives the beam of a baseline (a row) in directions.
    """
    vectors = row_vectors(block) if vectors is None else vectors
    common = of_direction(block)
    rows = np.empty(block.shape, dtype=complex)
    for t, itime in enumerate(block.times.tolist()):
        index, _, _ = block.positions.above_horizon(itime)
        flux = block.setup.sky.flux[block.channel, index]
        directions = turn(unit_vectors(block, itime), itime)
        for row, vector in enumerate(vectors):
            seen = common(directions) if beam is None else beam(directions, row)
            phase = 2 * np.pi * block.freq / C * (vector @ directions)
            rows[t, row] = 0.5 * np.sum(flux * seen * np.exp(1j * phase))
    return rows


def seen_by_the_beam(effect: Effect, block: RowBlock, x: FloatArray) -> ComplexArray:
    """Sum over the sources with what the effect makes of their fluxes, and over those that it adds."""
    rows = np.empty(block.shape, dtype=complex)
    for t, itime in enumerate(block.times.tolist()):
        sources = block.sources(itime)
        factor = effect.sky_factor(block.setup, sources, x)
        parts = [(sources.za, sources.az, sources.flux * (1.0 if factor is None else factor))]
        if (extra := effect.extra_sky(block, itime, x)) is not None:
            parts.append(extra)
        za, az, flux = (np.concatenate(part) for part in zip(*parts, strict=True))
        fringes = np.exp(2j * np.pi * block.freq / C * (row_vectors(block) @ enu(za, az)))
        rows[t] = 0.5 * fringes @ (flux * block.beam(za, az))
    return rows


def assert_same(one: ComplexArray, other: ComplexArray, block: RowBlock, rtol: float = 1e-9) -> None:
    """Compare within a fraction of the largest visibility."""
    np.testing.assert_allclose(one, other, rtol=0, atol=rtol * float(np.abs(block.vis).max()))
