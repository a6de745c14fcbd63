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
        values = (factor * self._values[self._above_horizon]).astype(np.float32)
        return HealpixMap(self._healpix.nside, self._healpix.order, self._above_horizon, values)

    @property
    def _above_horizon(self) -> IntArray:
        """Numbers of the pixels between which directions above the horizon lie."""
        _, latitude = self._healpix.healpix_to_lonlat(np.arange(self._healpix.npix))
        # Rings are less than a pixel apart.
        return np.flatnonzero(latitude >= -self._healpix.pixel_resolution)

    def describe(self) -> dict[str, Any]:
        """Return what a real map `times` a factor is restored from; its values single precision in base 64."""
        values = self._values[self._above_horizon].astype("<f4")
        return {
            "nside": int(self._healpix.nside),
            "ordering": self._healpix.order,
            "values": base64.b64encode(values.tobytes()).decode(),
        }

    @classmethod
    def from_description(cls, description: Mapping[str, Any]) -> HealpixMap:
        """Restore it from a description; ValueError where it is none."""
        empty = cls(description["nside"], description["ordering"], np.zeros(0, dtype=int), np.zeros(0))
        values = np.frombuffer(base64.b64decode(description["values"], validate=True), "<f4")
        if len(values) != len(empty._above_horizon):
            raise ValueError("not one number for each pixel")
        return cls(description["nside"], description["ordering"], empty._above_horizon, values)
