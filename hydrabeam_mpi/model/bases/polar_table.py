"""A beam between the nodes of a table in polar coordinates: quintic splines, whose slopes come with their values.

The cost of a beam's modes is paid once, at the nodes, and not for every source, antenna and step of a slope. With the
nodes that `n_nodes` gives, the highest modes of a basis are off by a millionth of themselves, a beam by less than 1e-10
of its peak and its slopes by less than 1e-7 of theirs.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.ndimage import spline_filter1d

from hydrabeam_mpi.data.observation import FloatArray

ORDER = 5
HALF = ORDER // 2
MARGIN = 16
"""Nodes beyond the largest radius, where the spline does not know how the beam goes on; it forgets in a few."""
_POINTS_AT_ONCE = 2048  # whose weights stay in cache


HORIZON = np.sin(np.pi / 4)


def radii(per_unit: int) -> FloatArray:
    """Return the radii sin(za / 2) of a table with so many nodes per unit, (Nradii,)."""
    return np.arange(int(per_unit * HORIZON) + MARGIN) / per_unit


def n_nodes(radial: float, azimuthal: int) -> tuple[int, int]:
    """Return the nodes per unit radius and per turn that so many half waves and whole waves need."""
    return max(int(10 * radial), 32), max(14 * azimuthal, 32)


class PolarTable:
    """Splines of a real function of zenith angle and azimuth that is even in the radius sin(za / 2).

    Parameters
    ----------
    values : ndarray, (Nradii, Naz)
        At `radii`, and at azimuths that divide the turn evenly, beginning at 0.
    per_unit : int
        Radial nodes per unit.
    """

    def __init__(self, values: FloatArray, per_unit: int) -> None:
        self.per_unit, self.n_az = per_unit, values.shape[1]
        around = spline_filter1d(values, ORDER, axis=1, mode="grid-wrap")
        coeffs = spline_filter1d(around, ORDER, axis=0, mode="mirror")
        coeffs = np.concatenate([coeffs[HALF:0:-1], coeffs])
        self._coeffs = np.pad(coeffs, ((0, 0), (HALF, ORDER - HALF + 1)), mode="wrap")

    def __call__(self, za: FloatArray, az: FloatArray) -> FloatArray:
        """Interpolate at zenith angles up to the horizon and azimuths in [0, 2 pi], (Npoints,)."""
        return np.asarray(self._evaluate(za, az, slopes=False)[0])

    def slopes(self, za: FloatArray, az: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the derivatives by zenith angle and by azimuth, per radian, (Npoints,) each."""
        _, by_radius, by_az = self._evaluate(za, az, slopes=True)
        return by_radius * (0.5 * self.per_unit * np.cos(0.5 * za)), by_az * (self.n_az / (2 * np.pi))

    def _evaluate(self, za: FloatArray, az: FloatArray, slopes: bool) -> FloatArray:
        """Return the value, and with ``slopes`` the derivatives by either number of nodes, (1 or 3, Npoints)."""
        out = np.empty((3 if slopes else 1, len(za)))
        for start in range(0, len(za), _POINTS_AT_ONCE):
            part = slice(start, start + _POINTS_AT_ONCE)
            along, across = np.sin(0.5 * za[part]) * self.per_unit, az[part] * (self.n_az / (2 * np.pi))
            row, column = along.astype(int), across.astype(int)
            by_row, change_by_row = _weights(along - row)
            by_column, change_by_column = _weights(across - column)
            first = row * self._coeffs.shape[1] + column
            for p in range(ORDER + 1):
                around: Any = 0.0
                change: Any = 0.0
                for q in range(ORDER + 1):
                    coeffs = self._coeffs.reshape(-1).take(first + (p * self._coeffs.shape[1] + q))
                    around = around + by_column[q] * coeffs
                    if slopes:
                        change = change + change_by_column[q] * coeffs
                terms = (by_row[p] * around, change_by_row[p] * around, by_row[p] * change)[: len(out)]
                for total, term in zip(out[:, part], terms, strict=True):
                    total[:] = term if p == 0 else total + term
        return out


def _weights(fraction: FloatArray) -> tuple[list[FloatArray], list[FloatArray]]:
    """Return the weights of the `ORDER` + 1 nodes around each point and their derivatives, (Npoints,) each.

    ``fraction`` is how far the point is beyond the last node before it; B-splines by their recursion in the order.
    """
    none = np.zeros_like(fraction)
    splines = [np.ones_like(fraction)]
    lower = splines
    for order in range(1, ORDER + 1):
        lower = splines
        here, before = [*lower, none], [none, *lower]
        splines = [
            ((fraction + m) * here[m] + (order + 1 - m - fraction) * before[m]) / order for m in range(order + 1)
        ]
    changes = [one - two for one, two in zip([*lower, none], [none, *lower], strict=True)]
    return splines[::-1], changes[::-1]
