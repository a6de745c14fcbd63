"""Skies whose direction cosines are shifted: what a gradient of phase over the array does to where sources are seen.

A source at the direction cosines (l, m), n = cos za, is seen at (l, m) + p(n) (e, n), with p the path through what
shifts it, one at the zenith. That is the same for all baselines, as its phase is a gradient over the antennas.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from hydrabeam_mpi.data.observation import C_M_PER_S, EARTH_RADIUS, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.interface.sources import Sources
from hydrabeam_mpi.effects.shared.displaced import angles
from hydrabeam_mpi.model.engines.fringes import enu
from hydrabeam_mpi.model.positions import SourcePositions
from hydrabeam_mpi.model.sky import Sky

SHELL_HEIGHT = 350e3
"""m, of most electrons of the ionosphere; usual for maps of their column (Mannucci et al. 1998)."""
LOWEST = 0.02
"""Cosine of the zenith angle, a degree above the horizon, below which places change too fast to be linearised."""

Path = Callable[[FloatArray], FloatArray]


def flat_path(cos_za: FloatArray) -> FloatArray:
    """Return the same for all directions, (N,)."""
    return np.ones_like(cos_za)


def shell_path(cos_za: FloatArray) -> FloatArray:
    """Return the path through a thin shell around the Earth beside that at the zenith, (N,)."""
    sine = EARTH_RADIUS / (EARTH_RADIUS + SHELL_HEIGHT) * np.sqrt(np.maximum(1 - cos_za**2, 0.0))
    return np.asarray(1 / np.sqrt(1 - sine**2))


@dataclass(frozen=True)
class ShiftedPositions:
    """Places of sources, shifted at every time.

    Attributes
    ----------
    positions : SourcePositions
        Where they are without.
    shifts : dict of int to ndarray, (2,)
        Of each time: of the direction cosines towards East and North at the zenith.
    path : callable
        By which that is multiplied at other cosines of the zenith angle.
    """

    positions: SourcePositions
    shifts: dict[int, FloatArray]
    path: Path

    def above_horizon(self, itime: int, below: float = 0.0) -> tuple[IntArray, FloatArray, FloatArray]:
        """Find the sources that are seen above the horizon, of those that are; see `SourcePositions.above_horizon`.

        Each is (Nup,).
        """
        index, za, az = self.positions.above_horizon(itime, below)
        if not self.shifts[itime].any():
            return index, za, az
        vectors = enu(za, az)
        vectors[:2] += self.path(vectors[2]) * self.shifts[itime][:, np.newaxis]
        left = 1 - vectors[0] ** 2 - vectors[1] ** 2
        vectors[2] = np.copysign(np.sqrt(np.maximum(left, 0.0)), vectors[2])
        seen = left > 0
        return index[seen], *angles(vectors[:, seen])

    def follow(self, sky: Sky) -> ShiftedPositions:
        """Follow another sky, shifted alike."""
        return replace(self, positions=self.positions.follow(sky))


def shifting_columns(sources: Sources, path: Path) -> FloatArray:
    """Return the beam, three moments of it, and its slopes by either shift, (6, Nsrc); see `shifting_rates`."""
    east, north, cos_za = sources.enu
    scale, low = path(cos_za), 1 / np.maximum(cos_za, LOWEST)
    beam, slope = sources.exact_beam, sources.slope
    moments = beam * scale * np.stack([np.ones_like(low), east * low, north * low])
    slopes = scale * np.stack([slope[0] - east * low * slope[2], slope[1] - north * low * slope[2]])
    return np.concatenate([beam[np.newaxis], moments, slopes])


def shifting_rates(block: RowBlock, moments: ComplexArray) -> ComplexArray:
    """Return how visibilities change as the sky is shifted towards East and North, Jy, (Ntimes, Ngroups, 2).

    The integrals of `shifting_columns`, (Ntimes, Ngroups, 6), are of the block's groups. A direction changes by
    p (1, 0, -l/n) and p (0, 1, -m/n).
    """
    east, north, up = block.vectors.T
    along = np.stack([east * moments[..., 1] - up * moments[..., 2], north * moments[..., 1] - up * moments[..., 3]])
    return np.asarray(moments[..., 4:] + 2j * np.pi * block.freq / C_M_PER_S * np.moveaxis(along, 0, -1))
