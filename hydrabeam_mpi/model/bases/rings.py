"""Beam samples on the sky, and the rings of equal zenith angle on which most beam files have them.

Both grids in use, azimuth x zenith angle and HEALPix, consist of rings with (nearly) equally spaced azimuths. On
such a ring the azimuthal functions are orthogonal, so a fit falls apart into one small problem for every m.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hydrabeam_mpi.data.observation import Array, FloatArray, IntArray

# Angles closer than this (radians, 0.02 arcsec) are the same angle.
SAME_ANGLE = 1e-7
FEWEST_AZIMUTHS = 3
"""Of a ring, unless it is the zenith: fewer do not resolve a beam's shape in azimuth."""
LARGEST_GAP = 1.5
"""Azimuths go all around where no gap is larger than this many times the mean."""


@dataclass(frozen=True)
class Pixels:
    """Samples of a beam above the horizon.

    Attributes
    ----------
    za, az : ndarray, (Npix,)
        Radians.
    values : ndarray of float or complex, (Npix,)
    """

    za: FloatArray
    az: FloatArray
    values: Array

    @classmethod
    def above_horizon(cls, za: FloatArray, az: FloatArray, values: Array) -> Pixels:
        """Keep the samples with za <= 90 degrees that are not NaN; each is (Npoints,)."""
        keep = (za <= np.pi / 2 + SAME_ANGLE) & ~np.isnan(values)
        return cls(za[keep], az[keep], values[keep])


@dataclass(frozen=True)
class RingGrid:
    """Samples on full rings of equal zenith angle.

    Attributes
    ----------
    za : ndarray, (Nrings,)
        Zenith angle of each ring, ascending.
    n_az : ndarray of int, (Nrings,)
        Number of azimuths on each ring.
    az : ndarray, (Npix,)
        Ring after ring, azimuth ascending.
    values : ndarray, (..., Npix)
        Of one beam or of several.
    """

    za: FloatArray
    n_az: IntArray
    az: FloatArray
    values: Array

    @classmethod
    def from_pixels(cls, pixels: Pixels) -> RingGrid | None:
        """Find the rings; None where samples do not lie on rings that go evenly all around."""
        order = np.argsort(pixels.za, kind="stable")
        za = pixels.za[order]
        ring = np.concatenate([[0], np.cumsum(np.diff(za) > SAME_ANGLE)])
        az = np.mod(pixels.az[order] + SAME_ANGLE, 2 * np.pi) - SAME_ANGLE
        within = np.lexsort((az, ring))
        za, az, values = za[within], az[within], pixels.values[..., order[within]]
        # Grids that close the circle repeat azimuth 0 as 2 pi.
        new = np.concatenate([[True], (np.diff(az) > SAME_ANGLE) | (np.diff(ring) > 0)])
        za, az, values, ring = za[new], az[new], values[..., new], ring[new]
        n_az = np.bincount(ring)
        start = np.cumsum(n_az) - n_az
        gap = np.append(np.diff(az), 0.0)
        gap[start + n_az - 1] = az[start] + 2 * np.pi - az[start + n_az - 1]
        uneven = gap > LARGEST_GAP * 2 * np.pi / n_az[ring]
        few = (n_az < FEWEST_AZIMUTHS) & (za[start] > SAME_ANGLE)
        return None if uneven.any() or few.any() else cls(za[start], n_az, az, values)

    def azimuthal_orders(self, m_max: int) -> NDArray[np.complex128]:
        """Return the coefficients of exp(i m az) on each ring, m = -m_max..m_max, (..., Nrings, 2 m_max + 1).

        On equally spaced azimuths these are means of ``B exp(-i m az)``; on others, a least-squares fit.
        """
        m = np.arange(-m_max, m_max + 1)
        orders = np.zeros((*self.values.shape[:-1], len(self.za), len(m)), dtype=np.complex128)
        ends = np.cumsum(self.n_az)[:-1]
        rings = zip(np.split(self.az, ends), np.split(self.values, ends, axis=-1), strict=True)
        for number, (az, ring) in enumerate(rings):
            n = len(az)
            if np.abs(az - az[0] - 2 * np.pi * np.arange(n) / n).max() < 10 * SAME_ANGLE:
                orders[..., number, :] = np.fft.fft(ring)[..., m % n] * np.exp(-1j * m * az[0]) / n
            else:
                held = 2 * np.abs(m) < n
                found = np.linalg.lstsq(np.exp(1j * np.outer(az, m[held])), ring.T, rcond=None)[0]
                orders[..., number, held] = found.T
        if not np.iscomplexobj(self.values):
            # To the last digit, so that the two modes of a pair rank equal.
            orders = 0.5 * (orders + orders[..., ::-1].conj())
        return orders


def degree_grid() -> tuple[FloatArray, FloatArray]:
    """Return za and az of the 1 degree grid, za = 0..90, az = 0..359, az fastest, (91 * 360,) each."""
    za, az = np.meshgrid(np.deg2rad(np.arange(91)), np.deg2rad(np.arange(360)), indexing="ij")
    return za.ravel(), az.ravel()
