"""Obstruction near the horizon: sources low in the sky are seen through a transmission 1 + x of their direction."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray, IntArray
from hydrabeam_mpi.effects.base import Columns, Effect, Parameters
from hydrabeam_mpi.effects.experiment import Experiment
from hydrabeam_mpi.effects.scene import Scene
from hydrabeam_mpi.effects.sources import Sources

EDGES = np.array(
    [0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 7.0, 10.0]
)  # elevations between which a ring lies, degrees
RINGS = len(EDGES) - 1
SECTORS = 12
WIDTH = 360 // SECTORS  # degrees of azimuth


class Horizon(Effect):
    """Transmission of the last ten degrees above the horizon, less one; each channel its own.

    Rings of elevation with edges at 0, 1, 2, 3, 5, 7 and 10 degrees have a parameter for all azimuths, and one more for
    each of twelve sectors of azimuth (from East through North). Both add up: a sector transmits 1 + x_ring + x_sector.
    A ridge all around takes few of the first kind, a hill a few of the second, and what it hides has x = -1.
    """

    kind = "horizon"
    title = "obstruction near the horizon"
    changes_sky = True

    def parameters(self, experiment: Experiment) -> Parameters:
        """Return the rings' transmissions less one, then those of their sectors; each may be at fault by itself."""
        azimuths = ["all azimuths", *(f"az {az}-{az + WIDTH} deg" for az in range(0, 360, WIDTH))]
        rings = [f"elevation {lo:g}-{hi:g} deg" for lo, hi in pairwise(EDGES)]
        names = [f"{ring}, {azimuths[0]}" for ring in rings]
        names += [f"{ring}, {azimuth}" for ring in rings for azimuth in azimuths[1:]]
        return Parameters.of(names, "", 1.0, np.arange(len(names)))

    def sky_columns(self, sources: Sources) -> FloatArray:
        """Return the beam in each sector of each ring, zero elsewhere."""
        low, sector = _sectors(sources)
        columns = np.zeros((RINGS * SECTORS, len(sources.az)))
        columns[sector, low] = sources.beam[low]
        return columns

    def sky_factor(self, experiment: Experiment, sources: Sources, x: FloatArray) -> FloatArray:
        """Return each source's transmission."""
        low, sector = _sectors(sources)
        factor = np.ones(len(sources.az))
        factor[low] += x[sector // SECTORS] + x[RINGS + sector]
        return factor

    def columns(self, scene: Scene, x: FloatArray) -> Columns:
        """Return the visibilities of each ring's and each sector's sources."""
        sectors = scene.integrals[self.kind]
        rings = sectors.reshape(*sectors.shape[:2], RINGS, SECTORS).sum(axis=-1)
        values = np.concatenate([rings, sectors], axis=-1)
        return Columns(values, values.shape[-1], by_group=True)

    def draw(self, experiment: Experiment, rng: np.random.Generator, strength: float) -> FloatArray:
        """Draw losses of rms ``strength`` x scale; nothing is lost twice."""
        scale = self.parameters(experiment).scale
        losses = strength * scale * np.abs(rng.standard_normal(len(scale)))
        rings = np.minimum(losses[:RINGS], 1.0)
        sectors = np.minimum(losses[RINGS:], np.repeat(1 - rings, SECTORS))
        return -np.concatenate([rings, sectors])


def _sectors(sources: Sources) -> tuple[IntArray, IntArray]:
    """Return the sources that are low in the sky, and of each its ring times the number of sectors plus its sector."""
    elevation, az = 90 - np.rad2deg(sources.za), np.rad2deg(sources.az)
    low = np.flatnonzero(elevation < EDGES[-1])
    ring = np.maximum(np.searchsorted(EDGES, elevation[low], side="right") - 1, 0)
    return low, ring * SECTORS + (az[low] // WIDTH).astype(int) % SECTORS
