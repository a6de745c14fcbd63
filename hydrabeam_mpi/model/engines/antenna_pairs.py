"""Baseline vectors that are differences of a few points: their fringes are products of the points' phases."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from hydrabeam_mpi.data.observation import FloatArray, IntArray

SAME = 1e-7
"""Metres within which a vector is the difference of two points: 3e-7 of a turn at a wavelength of 0.3 m, as far as
vectors of a lattice are from it."""


@dataclass(frozen=True)
class AntennaPairs:
    """Vectors as differences of points: ``vectors[rows] = points[second] - points[first]``.

    Attributes
    ----------
    points : ndarray, (Npoints, 3)
        Metres ENU; those that are asked for.
    rows, first, second : ndarray of int, (Nrows,)
    rest : ndarray of int, (Nvectors - Nrows,)
        Vectors that are no such difference, as means over baselines that are nearly alike.
    """

    points: FloatArray
    rows: IntArray
    first: IntArray
    second: IntArray
    rest: IntArray


def find_pairs(vectors: FloatArray, points: FloatArray) -> AntennaPairs | None:
    """Find the ``points``, (Npoints, 3), of which ``vectors``, (Nvectors, 3), are differences, where that saves work.

    None where there are fewer such vectors than points: an exponential each costs less then.
    """
    one, two = np.triu_indices(len(points), 1)
    if not len(vectors) or len(one) < len(vectors) / 2 or len(points) > len(vectors):
        return None
    apart = points[two] - points[one]
    away, nearest = cKDTree(np.concatenate([apart, -apart])).query(vectors, distance_upper_bound=SAME)
    rows = np.flatnonzero(np.isfinite(away))
    pair, turned = nearest[rows] % len(one), nearest[rows] >= len(one)
    first, second = np.where(turned, two[pair], one[pair]), np.where(turned, one[pair], two[pair])
    used, index = np.unique(np.concatenate([first, second]), return_inverse=True)
    if len(used) >= len(rows):
        return None
    rest = np.setdiff1d(np.arange(len(vectors)), rows)
    return AntennaPairs(points[used], rows, index[: len(rows)], index[len(rows) :], rest)
