"""A beam between the nodes of a table in polar coordinates: quintic splines, whose slopes come with their values.

The cost of a beam's modes is paid once, at the nodes, and not for every source, antenna and step of a slope. With the
nodes that `n_nodes` gives, the highest modes of a basis are off by a millionth of themselves, a beam by less than 1e-10
of its peak and its slopes by less than 1e-7 of theirs.
"""

from __future__ import annotations

from math import factorial

import numpy as np
from scipy.interpolate import BSpline
from scipy.ndimage import spline_filter1d

from hydrabeam_mpi.compiled import Compiled
from hydrabeam_mpi.data.observation import FloatArray

ORDER = 5
HALF = ORDER // 2
MARGIN = 16
"""Nodes beyond the zenith and the largest radius, where the spline does not know how the beam goes on; it forgets in a
few."""
HORIZON = np.sin(np.pi / 4)
"""The radius sin(za / 2) there."""
LANES = 8
"""Nodes of a row that are summed together, of which those beyond the spline's own count nothing: as many as processors
take at once."""


def radii(per_unit: int) -> FloatArray:
    """Return the radii sin(za / 2) of a table with so many nodes per unit, (Nradii,)."""
    return np.arange(int(per_unit * HORIZON) + MARGIN) / per_unit


def n_nodes(radial: float, azimuthal: int) -> tuple[int, int]:
    """Return the nodes per unit radius and per turn that so many half waves and whole waves need."""
    return max(int(10 * radial), 32), max(14 * azimuthal, 32)


class PolarTable:
    """Splines of a real function of zenith angle and azimuth.

    Parameters
    ----------
    values : ndarray, (Nradii, Naz)
        At `radii`, and at azimuths that divide the turn evenly, beginning at 0.
    per_unit : int
        Radial nodes per unit.
    through_zenith : bool
        Whether it goes on smoothly through the zenith, to the azimuths on the other side, of which there is an even
        number; else it is even in the radius sin(za / 2) at each azimuth.
    """

    def __init__(self, values: FloatArray, per_unit: int, through_zenith: bool = False) -> None:
        self.per_unit, self.n_az = per_unit, values.shape[1]
        beyond = np.roll(values, self.n_az // 2, axis=1) if through_zenith else values
        values = np.concatenate([beyond[MARGIN:0:-1], values])
        around = spline_filter1d(values, ORDER, axis=1, mode="grid-wrap")
        coeffs = spline_filter1d(around, ORDER, axis=0, mode="mirror")[MARGIN - HALF :]
        self._coeffs = np.pad(coeffs, ((0, 0), (HALF, LANES - HALF)), mode="wrap")

    def __call__(self, za: FloatArray, az: FloatArray) -> FloatArray:
        """Interpolate at zenith angles up to the horizon and azimuths in [0, 2 pi], (Npoints,)."""
        return self._evaluate(za, az)[0]

    def with_slopes(self, za: FloatArray, az: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return that and the derivatives by zenith angle and by azimuth, per radian, (Npoints,) each."""
        value, by_radius, by_az = self._evaluate(za, az)
        by_radius *= 0.5 * self.per_unit * np.cos(0.5 * za)
        by_az *= self.n_az / (2 * np.pi)
        return value, by_radius, by_az

    def _evaluate(self, za: FloatArray, az: FloatArray) -> FloatArray:
        """Return the value and the derivatives by either number of nodes, (3, Npoints)."""
        out = np.empty((3, len(za)))
        _interpolate(self._coeffs, np.sin(0.5 * za) * self.per_unit, az * (self.n_az / (2 * np.pi)), out)
        return out


@Compiled
def _interpolate(coeffs: FloatArray, along: FloatArray, across: FloatArray, out: FloatArray) -> None:
    """Find the value and the derivatives at numbers of rows and columns, (Npoints,); ``out`` is (3, Npoints).

    Loops over nodes of a row are what a processor does in one go.
    """
    weights = np.empty((4, LANES))
    for point in range(len(along)):
        row, column = int(along[point]), int(across[point])
        beyond_row, beyond_column = along[point] - row, across[point] - column
        for node in range(LANES):
            # Horner's scheme, of the polynomials and of their derivatives.
            by_row = by_column = _PIECES[0, node]
            row_slope = column_slope = 0.0
            for power in range(1, ORDER + 1):
                row_slope = row_slope * beyond_row + by_row
                column_slope = column_slope * beyond_column + by_column
                by_row = by_row * beyond_row + _PIECES[power, node]
                by_column = by_column * beyond_column + _PIECES[power, node]
            weights[0, node], weights[1, node] = by_row, by_column
            weights[2, node], weights[3, node] = row_slope, column_slope
        value = by_along = by_across = 0.0
        for near in range(ORDER + 1):
            in_row = slope_in_row = 0.0
            for node in range(LANES):
                in_row += weights[1, node] * coeffs[row + near, column + node]
                slope_in_row += weights[3, node] * coeffs[row + near, column + node]
            value += weights[0, near] * in_row
            by_along += weights[2, near] * in_row
            by_across += weights[0, near] * slope_in_row
        out[0, point], out[1, point], out[2, point] = value, by_along, by_across


def _pieces() -> FloatArray:
    """Return the polynomials that a B-spline consists of, by falling powers, last one first, (`ORDER` + 1, `LANES`)."""
    spline = BSpline.basis_element(np.arange(ORDER + 2.0))
    powers = range(ORDER + 1)
    pieces = np.array([[spline(float(m), nu=j) / factorial(j) for m in reversed(powers)] for j in reversed(powers)])
    return np.pad(pieces, ((0, 0), (0, LANES - ORDER - 1)))


_PIECES = _pieces()
