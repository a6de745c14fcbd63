"""The visibilities of a small scene by plain sums over sources, with directions, beams and vectors of one's own."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray
from hydrabeam_mpi.effects.base import Effect
from hydrabeam_mpi.effects.scene import Scene
from hydrabeam_mpi.model.positions import enu

C = 299792458.0
BeamOfDirection = Callable[[FloatArray], FloatArray]


def unit_vectors(scene: Scene, itime: int) -> FloatArray:
    """Directions of the sources above the horizon, (3, Nsrc)."""
    _, za, az = scene.positions.above_horizon(itime)
    return np.stack([np.sin(za) * np.cos(az), np.sin(za) * np.sin(az), np.cos(za)])


def of_direction(scene: Scene) -> BeamOfDirection:
    """The scene's beam as a function of unit vectors, at most at the horizon."""

    def beam(vectors: FloatArray) -> FloatArray:
        east, north, up = vectors
        return np.asarray(scene.beam(np.arccos(np.clip(up, 0, 1)), np.arctan2(north, east))).real

    return beam


def row_vectors(scene: Scene) -> FloatArray:
    """Vectors from the antennas' positions in the sense of the groups, (Nbls, 3)."""
    antpos = scene.experiment.observation.antpos
    return antpos[scene.ant2] - antpos[scene.ant1]


def visibilities(
    scene: Scene,
    vectors: FloatArray | None = None,
    turn: Callable[[FloatArray, int], FloatArray] = lambda directions, itime: directions,
    beam: Callable[[FloatArray, int], FloatArray] | None = None,
) -> ComplexArray:
    """Sum over the sources, (Ntimes, Nbls).

    ``turn`` moves the directions of a time; ``beam`` gives the beam of a baseline (a row) in directions.
    """
    vectors = row_vectors(scene) if vectors is None else vectors
    common = of_direction(scene)
    rows = np.empty(scene.shape, dtype=complex)
    for t, itime in enumerate(scene.times.tolist()):
        index, _, _ = scene.positions.above_horizon(itime)
        flux = scene.experiment.sky.flux[scene.channel, index]
        directions = turn(unit_vectors(scene, itime), itime)
        for row, vector in enumerate(vectors):
            seen = common(directions) if beam is None else beam(directions, row)
            phase = 2 * np.pi * scene.freq / C * (vector @ directions)
            rows[t, row] = 0.5 * np.sum(flux * seen * np.exp(1j * phase))
    return rows


def seen_by_the_beam(effect: Effect, scene: Scene, x: FloatArray) -> ComplexArray:
    """Sum over the sources with what the effect makes of their fluxes, and over those that it adds."""
    rows = np.empty(scene.shape, dtype=complex)
    for t, itime in enumerate(scene.times.tolist()):
        sources = scene.sources(itime)
        flux = sources.flux * effect.sky_factor(scene.experiment, sources, x)
        parts = [(sources.za, sources.az, flux)]
        if (extra := effect.extra_sky(scene, itime, x)) is not None:
            parts.append(extra)
        za, az, flux = (np.concatenate(part) for part in zip(*parts, strict=True))
        fringes = np.exp(2j * np.pi * scene.freq / C * (row_vectors(scene) @ enu(za, az)))
        rows[t] = 0.5 * fringes @ (flux * scene.beam(za, az))
    return rows


def assert_same(one: ComplexArray, other: ComplexArray, scene: Scene, rtol: float = 1e-9) -> None:
    """Compare within a fraction of the largest visibility."""
    np.testing.assert_allclose(one, other, rtol=0, atol=rtol * float(np.abs(scene.vis).max()))
