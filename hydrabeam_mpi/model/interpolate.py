"""Interpolation of beam samples on a grid of azimuths and zenith angles."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import RectBivariateSpline

from hydrabeam_mpi.data.observation import Array, BoolArray, FloatArray
from hydrabeam_mpi.errors import InputError

# Samples repeated on either side of the circle, so that a cubic spline does not notice where it is cut.
_OVERLAP = 6
_TOLERANCE = 1e-6
_REMEDY = "give a beam file with samples there"


class AzZaGrid:
    """Bicubic splines on an azimuth x zenith angle grid, periodic in azimuth.

    Parameters
    ----------
    za : ndarray, (Nza,)
        Radians, ascending. Below the horizon, samples from the first NaN on are ignored.
    az : ndarray, (Naz,)
        Radians, ascending, within one turn; need not be equally spaced across the cut.
    values : ndarray of float or complex, (Nza, Naz)

    Raises
    ------
    InputError
        On evaluation: if a sample above the horizon is NaN, or a direction is beyond the samples.
    """

    def __init__(self, za: FloatArray, az: FloatArray, values: Array) -> None:
        gaps: BoolArray = np.logical_or.reduce(np.isnan(values), axis=1)
        usable = np.flatnonzero(np.cumsum(gaps & (za > np.pi / 2 + _TOLERANCE)) == 0)
        self._za_max = za[usable][-1]
        self._has_gaps = bool(gaps[usable].any())
        self._az_start = az[0]
        overlap = min(_OVERLAP, len(az))
        turns = np.concatenate([az[-overlap:] - 2 * np.pi, az, az[:overlap] + 2 * np.pi])
        padded = np.concatenate([values[:, -overlap:], values, values[:, :overlap]], axis=1)[usable]
        self._parts: list[RectBivariateSpline] = []
        if not self._has_gaps:
            orders = {"kx": min(3, len(usable) - 1), "ky": 3}
            parts = [padded.real, padded.imag] if np.iscomplexobj(padded) else [padded]
            self._parts = [RectBivariateSpline(za[usable], turns, part, **orders) for part in parts]

    def __call__(self, za: FloatArray, az: FloatArray) -> Array:
        """Interpolate at (za, az), (Npoints,) each."""
        if self._has_gaps:
            raise InputError("samples that are NaN cannot be interpolated", remedy=_REMEDY)
        if np.size(za) and np.max(za) > self._za_max + _TOLERANCE:
            raise InputError(f"the samples end at a zenith angle of {np.rad2deg(self._za_max):.4g} deg", remedy=_REMEDY)
        within = self._az_start + np.mod(az - self._az_start, 2 * np.pi)
        parts = [spline.ev(za, within) for spline in self._parts]
        return parts[0] if len(parts) == 1 else parts[0] + 1j * parts[1]
