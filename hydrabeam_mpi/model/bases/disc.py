"""What bases on the hemisphere projected to a disc have in common."""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.errors import InputError

EDGE = 23 * np.pi / 45
"""Zenith angle of the rim of the disc in the paper: 92 degrees."""


def check_edge(edge: float) -> None:
    """Raise `InputError` for a rim that is no zenith angle (radians), or of a disc without points."""
    if not 0 < edge <= np.pi:
        raise InputError(f"edge = {edge} rad is not between 0 and pi", field="edge", remedy="give degrees above 0")


def azimuthal_around(m_max: int, n_az: int) -> FloatArray:
    """Return `azimuthal_rows` at azimuths that divide the turn evenly, beginning at 0, (2 m_max + 2, n_az)."""
    rows, az = np.empty((2 * m_max + 2, n_az)), np.linspace(0, 2 * np.pi, n_az, endpoint=False)
    azimuthal_rows(az, rows, np.empty((m_max + 1, n_az)))
    return rows


def azimuthal_rows(az: FloatArray, out: FloatArray, work: FloatArray) -> None:
    """Fill ``out`` with cos(m az), sin(m az) for m = 0, 1, ..., by angle addition in growing blocks.

    Parameters
    ----------
    az : ndarray, (Npoints,)
    out : ndarray, (2 m_max + 2, Npoints), C order
    work : ndarray, (at least 1, Npoints)
        Overwritten.
    """
    pairs = out.reshape(len(out) // 2, 2, len(az))
    pairs[0, 0], pairs[0, 1] = 1, 0
    if len(pairs) > 1:
        np.cos(az, out=pairs[1, 0])
        np.sin(az, out=pairs[1, 1])
    known = 1
    while known < len(pairs) - 1:
        added = min(known, len(pairs) - 1 - known, len(work))
        low, high = pairs[1 : added + 1], pairs[known + 1 : known + added + 1]
        cos, sin = pairs[known]
        np.multiply(low, cos, high)
        np.multiply(low[:, 1], sin, work[:added])
        np.subtract(high[:, 0], work[:added], high[:, 0])
        np.multiply(low[:, 0], sin, work[:added])
        np.add(high[:, 1], work[:added], high[:, 1])
        known += added
