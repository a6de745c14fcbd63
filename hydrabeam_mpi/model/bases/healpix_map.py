"""Interpolation of beam samples between the pixels of a HEALPix map."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from typing import Any

import numpy as np
from astropy import units
from astropy_healpix import HEALPix

from hydrabeam_mpi.data.observation import Array, FloatArray, IntArray
from hydrabeam_mpi.errors import InputError


class HealpixMap:
    """Bilinear interpolation on a HEALPix map with azimuth as longitude and 90 degrees - za as latitude.

    Parameters
    ----------
    nside : int
    ordering : {"ring", "nested"}
    pixels : ndarray of int, (Npix,)
        Numbers of the pixels that are sampled; the others are missing.
    values : ndarray of float or complex, (Npix,)

    Raises
    ------
    InputError
        On evaluation: if a sample that is needed is missing or NaN.
    """

    def __init__(self, nside: int, ordering: str, pixels: IntArray, values: Array) -> None:
        self._healpix = HEALPix(nside, ordering)
        self._values = np.full(self._healpix.npix, np.nan, dtype=values.dtype)
        self._values[pixels] = values

    def __call__(self, za: FloatArray, az: FloatArray) -> Array:
        """Interpolate at (za, az), (Npoints,) each."""
        longitude, latitude = np.mod(az, 2 * np.pi) * units.rad, (np.pi / 2 - za) * units.rad
        around, weights = self._healpix.bilinear_interpolation_weights(longitude, latitude)
        # A neighbour without weight may be missing.
        samples = np.where(weights > 0, self._values[around], 0)
        if np.isnan(samples).any():
            raise InputError(
                "samples that are NaN or missing cannot be interpolated", remedy="give a beam file with samples there"
            )
        return np.einsum("ij,ij->j", weights, samples)

    def times(self, factor: float) -> HealpixMap:
        """Return a multiple of the map, of what is needed above the horizon, in single precision.

        So it is restored from its description as well.
        """
        pixels = _above_horizon(self._healpix)
        values = (factor * self._values[pixels]).astype(np.float32)
        return HealpixMap(self._healpix.nside, self._healpix.order, pixels, values)

    def describe(self) -> dict[str, Any]:
        """Return what a real map `times` a factor is restored from."""
        values = in_base64(self._values[_above_horizon(self._healpix)])
        return {"nside": int(self._healpix.nside), "ordering": self._healpix.order, "values": values}

    @classmethod
    def from_description(cls, description: Mapping[str, Any]) -> HealpixMap:
        """Restore it from a description; ValueError where it is none."""
        nside, ordering, values = (description[name] for name in ("nside", "ordering", "values"))
        pixels, numbers = _above_horizon(HEALPix(nside, ordering)), from_base64(values)
        if len(numbers) != len(pixels):
            raise ValueError("not one number for each pixel")
        return cls(nside, ordering, pixels, numbers)


def _above_horizon(healpix: HEALPix) -> IntArray:
    """Return the numbers of the pixels between which directions above the horizon lie."""
    _, latitude = healpix.healpix_to_lonlat(np.arange(healpix.npix))
    # Rings are less than a pixel apart.
    return np.flatnonzero(latitude >= -healpix.pixel_resolution)


def in_base64(values: Array) -> str:
    """Write numbers in single precision as text, for a description."""
    return base64.b64encode(values.astype("<f4").tobytes()).decode()


def from_base64(text: str) -> FloatArray:
    """Read numbers that `in_base64` has written; ValueError where it has not."""
    return np.frombuffer(base64.b64decode(text, validate=True), "<f4")
