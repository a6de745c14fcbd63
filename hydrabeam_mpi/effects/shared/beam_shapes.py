"""How the shape of a beam may change, whatever its basis: its widths and the levels of its sidelobes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.interface.sources import Sources
from hydrabeam_mpi.effects.shared.displaced import BeamToHorizon, azimuth

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


def reshaped(sources: Sources, shape: FloatArray) -> FloatArray:
    """Return the beam of an antenna with these amplitudes of the modes, (Nsrc,): stretched, sidelobes raised."""
    east_west, north_south, diagonal, *levels = shape
    plane = np.sin(NEARLY * sources.za) * np.stack([np.cos(sources.az), np.sin(sources.az)])
    stretch = np.array([[1 + east_west, diagonal], [diagonal, 1 + north_south]])
    x, y = np.linalg.solve(stretch, plane)
    za = np.arcsin(np.minimum(np.sqrt(x**2 + y**2), 1.0)) / NEARLY
    moved = replace(sources, za=za, az=azimuth(x, y), beam_function=BeamToHorizon(sources.beam_function))
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
    by_down, by_around = sources.by_tangents
    # By relative radius and by azimuth: d za = tan(0.9 za)/0.9 d ln(radius).
    by_radius = np.tan(NEARLY * sources.za) / NEARLY * by_down
    by_azimuth = np.sin(sources.za) * by_around
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
