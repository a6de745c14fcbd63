"""Antennas whose beams differ in shape."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray
from hydrabeam_mpi.effects.interface.effect import Columns, Effect, Parameters
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.interface.sources import Sources
from hydrabeam_mpi.effects.shared.antenna_beams import added_by_beams
from hydrabeam_mpi.effects.shared.displaced import need_real_beam
from hydrabeam_mpi.effects.shared.per_antenna import antenna_parameters, common_values, row_parameters

NEARLY = 0.9
"""Beams scale with the aperture in direction cosines, of radius sin za; sin(0.9 za) is regular at the horizon."""
SHARPNESS = 8
"""Sidelobes are where the beam B is small: as (1 - B)^8, which is a half at -11 dB."""
MODES = (
    "width East-West",
    "width North-South",
    "width North-East minus South-East",
    "sidelobes",
    "sidelobes East minus West",
    "sidelobes North minus South",
)


class NonredundantBeams(Effect):
    """Each antenna's power beam differs from the common one in a few low modes, each channel its own.

    The power beam of a baseline is the product of its antennas' voltage beams (`antenna_beams`), for small differences

        E_ij = 1/2 sum_n (c_i + c_j)_n D_n

    with D_n the visibilities of mode n, as which it is linearised. The modes come from the current beam itself,
    whatever its basis:

    - three widths: fractional stretches of the disc of direction cosines (nearly), along East-West, along North-South,
      and along one diagonal at the expense of the other. They do what a reflector's size, its astigmatism and
      a turned feed do;
    - three sidelobe levels: B (1 - B)^8 times 1, e and n (the direction cosines). They leave the main lobe as it is, so
      that they are no gain, no pointing and no width. They do what illumination, blockage and a feed off its axis
      (coma) do.

    A change by a constant is a gain, and a gradient of the beam is a pointing error: those are other effects. What all
    antennas have in common is a beam of another shape, which the beam's own freedom takes up.
    """

    kind = "nonredundant_beams"
    title = "beams that differ between antennas"

    def not_applicable(self, setup: ObservingSetup) -> str | None:
        """Refuse complex beams."""
        return need_real_beam(setup)

    def parameters(self, setup: ObservingSetup) -> Parameters:
        """Return the modes' amplitudes for every antenna: relative changes of width and of sidelobe level."""
        return antenna_parameters(setup, MODES, "", 0.05)

    def sky_columns(self, sources: Sources) -> FloatArray:
        """Return the modes, (6, Nsrc)."""
        return np.concatenate([stretches(sources), sidelobes(sources)])

    def degenerate_directions(self, setup: ObservingSetup) -> FloatArray:
        """Return the shape that all antennas have in common."""
        return common_values(len(setup.antennas_in_use), len(MODES))

    def columns(self, block: RowBlock, x: FloatArray) -> Columns:
        """Return half the modes' visibilities, for a row's first and second antenna."""
        values = block.spread(0.5 * np.tile(block.integrals[self.kind], 2))
        n_params = len(MODES) * len(block.setup.antennas_in_use)
        return Columns(values, n_params, row_parameters(block, len(MODES)))

    def added(self, block: RowBlock, x: FloatArray) -> ComplexArray:
        """Return what the antennas' shapes change, (Ntimes, Nbls)."""
        shapes = x.reshape(-1, len(MODES))
        shaped = np.flatnonzero(shapes.any(axis=1))

        def beams(sources: Sources) -> FloatArray:
            return np.array([reshaped(sources, shape) for shape in shapes[shaped]])

        return added_by_beams(block, shaped, beams)


def reshaped(sources: Sources, shape: FloatArray) -> FloatArray:
    """Return the beam of an antenna with these amplitudes of the modes, (Nsrc,): stretched, sidelobes raised."""
    east_west, north_south, diagonal, *levels = shape
    plane = np.sin(NEARLY * sources.za) * np.stack([np.cos(sources.az), np.sin(sources.az)])
    stretch = np.array([[1 + east_west, diagonal], [diagonal, 1 + north_south]])
    x, y = np.linalg.solve(stretch, plane)
    za = np.arcsin(np.minimum(np.hypot(x, y), 1.0)) / NEARLY
    moved = replace(sources, za=np.minimum(za, np.pi / 2), az=np.arctan2(y, x) % (2 * np.pi))
    # Sidelobes belong to the sky's directions, as columns do.
    east, north, _ = sources.enu
    return moved.beam + moved.beam * (1 - moved.beam) ** SHARPNESS * (levels[0] + levels[1] * east + levels[2] * north)


def stretches(sources: Sources) -> FloatArray:
    """Return how the beam changes as it is stretched in the plane, (3, Nsrc) per unit of relative stretch.

    The plane has radius sin(0.9 za), nearly that of direction cosines; there a stretch by 1 + c along x
    looks up the beam at x - c x, y. The rows are for East-West, for North-South, and for both diagonals, the one
    towards North-East by c and the other by -c.
    """
    cos_az, sin_az = np.cos(sources.az), np.sin(sources.az)
    down = np.stack([np.cos(sources.za) * cos_az, np.cos(sources.za) * sin_az, -np.sin(sources.za)])
    around = np.stack([-sin_az, cos_az, np.zeros_like(cos_az)])
    # By relative radius and by azimuth: d za = tan(0.9 za)/0.9 d ln(radius).
    by_radius = np.tan(NEARLY * sources.za) / NEARLY * (sources.slope * down).sum(axis=0)
    by_azimuth = np.sin(sources.za) * (sources.slope * around).sum(axis=0)
    shear = cos_az * sin_az
    return np.stack(
        [
            -(cos_az**2) * by_radius + shear * by_azimuth,
            -(sin_az**2) * by_radius - shear * by_azimuth,
            -2 * shear * by_radius - (cos_az**2 - sin_az**2) * by_azimuth,
        ]
    )


def sidelobes(sources: Sources) -> FloatArray:
    """Return B (1 - B)^8 and its products with the direction cosines towards East and North, (3, Nsrc)."""
    level = sources.beam * (1 - sources.beam) ** SHARPNESS
    east, north, _ = sources.enu
    return np.stack([level, level * east, level * north])
