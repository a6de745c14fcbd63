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

from hydrabeam_mpi.data.observation import FloatArray

ORDER = 5
HALF = ORDER // 2
MARGIN = 16
"""Nodes beyond the zenith and the largest radius, where the spline does not know how the beam goes on; it forgets in a
few."""
HORIZON = np.sin(np.pi / 4)
"""The radius sin(za / 2) there."""
_POINTS_AT_ONCE = 1024  # of which what is near stays in cache


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
        coeffs, stride = self._coeffs.reshape(-1), self._coeffs.shape[1]
        square = (np.arange(ORDER + 1)[:, np.newaxis] * stride + np.arange(ORDER + 1))[..., np.newaxis]
        for start in range(0, len(za), _POINTS_AT_ONCE):
            part = slice(start, start + _POINTS_AT_ONCE)
            along, across = np.sin(0.5 * za[part]) * self.per_unit, az[part] * (self.n_az / (2 * np.pi))
            row, column = along.astype(np.intp), across.astype(np.intp)
            by_row, by_column = _weights(along - row, slopes), _weights(across - column, slopes)
            # All are within the table; to clip is several times as fast as to check.
            near = coeffs.take(square + (row * stride + column), mode="clip")
            # For either set of weights of the columns, the sum over the nodes of a row.
            around = [np.einsum("pqn,qn->pn", near, weights) for weights in by_column]
            out[0, part] = np.einsum("pn,pn->n", by_row[0], around[0])
            if slopes:
                out[1, part] = np.einsum("pn,pn->n", by_row[1], around[0])
                out[2, part] = np.einsum("pn,pn->n", by_row[0], around[1])
        return out


def _weights(fraction: FloatArray, slopes: bool) -> FloatArray:
    """Return the weights of the nodes around each point, and their derivatives, (1 or 2, `ORDER` + 1, Npoints).

    ``fraction`` is how far the point is beyond the last node before it.
    """
    powers = np.ones((ORDER + 1, len(fraction)))
    for power in range(ORDER):
        np.multiply(powers[power], fraction, out=powers[power + 1])
    if not slopes:
        return (_PIECES @ powers)[np.newaxis]
    return np.stack([_PIECES @ powers, (_PIECES[:, 1:] * np.arange(1, ORDER + 1)) @ powers[:-1]])


def _pieces() -> FloatArray:
    """Return the polynomials that a B-spline consists of, last one first, by rising powers, (`ORDER` + 1,) squared."""
    spline = BSpline.basis_element(np.arange(ORDER + 2.0))
    powers = range(ORDER + 1)
    return np.array([[spline(float(m), nu=j) / factorial(j) for j in powers] for m in reversed(powers)])


_PIECES = _pieces()
