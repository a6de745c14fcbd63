"""Obstruction near the horizon: sources low in the sky are seen through a transmission 1 + x of their direction."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.base import Columns, Effect, Parameters
from hydrabeam_mpi.effects.scene import Experiment, Scene, Sources

RINGS = (80, 85, 90)  # edges in zenith angle, degrees
SECTORS = 12
WIDTH = 360 // SECTORS


class Horizon(Effect):
    """Transmission of the last ten degrees above the horizon, in two rings of twelve sectors; each channel its own.

    Azimuth runs from East through North. A hill that hides a sector has x = -1.
    """

    kind = "horizon"
    title = "obstruction near the horizon"

    def parameters(self, experiment: Experiment) -> Parameters:
        """Return every sector's transmission less one."""
        names = [
            f"za {lo}-{hi} deg, az {az}-{az + WIDTH} deg: transmission less one"
            for lo, hi in pairwise(RINGS)
            for az in range(0, 360, WIDTH)
        ]
        return Parameters.of(names, "", 0.3, np.arange(len(names)))

    def sky_columns(self, sources: Sources) -> FloatArray:
        """Return the beam in each sector, zero elsewhere."""
        za, az = np.rad2deg(sources.za), np.rad2deg(sources.az)
        low = np.flatnonzero(za >= RINGS[0])
        ring = np.minimum(np.searchsorted(RINGS, za[low], side="right"), len(RINGS) - 1) - 1
        sector = (az[low] // WIDTH).astype(int) % SECTORS
        columns = np.zeros((SECTORS * (len(RINGS) - 1), len(za)))
        columns[ring * SECTORS + sector, low] = sources.beam[low]
        return columns

    def columns(self, scene: Scene, x: FloatArray) -> Columns:
        """Return the visibilities of each sector's sources."""
        values = scene.integrals[self.kind]
        return Columns(values, values.shape[2], by_group=True)

    def draw(self, experiment: Experiment, rng: np.random.Generator, strength: float) -> FloatArray:
        """Draw losses of rms ``strength`` x scale; nothing is lost twice."""
        scale = self.parameters(experiment).scale
        return -np.minimum(strength * scale * np.abs(rng.standard_normal(len(scale))), 1.0)
