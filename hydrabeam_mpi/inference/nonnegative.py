"""A Gaussian where certain linear combinations of its unknowns are not negative, such as a power beam at some points.

Draws are those of Pakman and Paninski (2014, J. Comput. Graph. Stat. 23, 518). In units y of the Gaussian's own
deviations, x = mean + L^-H y, a particle of a random velocity v goes by y cos t + v sin t for a quarter of its period,
and is reflected where a combination becomes zero, at times that are known exactly: nothing is rejected, and the
Gaussian where all combinations are positive is left as it is. Where no combination is reached the draw is L^-H v about
the mean, independent of the one before.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import nnls

from hydrabeam_mpi.data.observation import Array, BoolArray, FloatArray
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.random import complex_normal

ROUNDING = 1e-12
"""Combinations of that part of the largest may be negative: where a draw ends on one that is zero, rounding decides."""


@dataclass(frozen=True)
class NonNegative:
    """Combinations Re sum_n rows_kn x_n that are not negative.

    Attributes
    ----------
    rows : ndarray, (K, n)
    """

    rows: Array

    def values(self, x: Array) -> FloatArray:
        """Return the combinations of some unknowns, (K,)."""
        return np.asarray((self.rows @ x).real)

    def holds(self, x: Array) -> bool:
        """Whether none of them is negative."""
        values = self.values(x)
        return bool(values.min() >= -ROUNDING * np.abs(values).max())

    def nearest(self, posterior: Posterior, x: Array) -> Array:
        """Return the unknowns nearest to some others, (n,), in units of a Gaussian's deviations, where all hold.

        The problem LDP of Lawson and Hanson (1974, chapter 23): least distance by non-negative least squares.
        """
        half = self._in_deviations(posterior)
        told = np.concatenate([half, -self.values(x)[np.newaxis]])
        multipliers, _ = nnls(told, np.eye(len(told))[-1])
        left = told @ multipliers
        step = left[:-1] / (1 - left[-1])
        return np.asarray(x + _from_deviations(posterior, step))

    def draw(self, posterior: Posterior, start: Array, rng: np.random.Generator) -> Array:
        """Draw from a Gaussian where all hold, from where they do, (n,)."""
        half, level = self._in_deviations(posterior), self.values(posterior.mean)
        white = complex_normal(rng, start.shape) if posterior.is_complex else rng.standard_normal(start.shape)
        place, velocity = _parts(posterior.factor.conj().T @ (start - posterior.mean)), _parts(white)
        path = half.T @ np.stack([place, velocity], axis=1)
        # What a unit of velocity along a combination gives to all of them; of those that are reached.
        pushes: dict[int, FloatArray] = {}
        left = np.pi / 2
        while True:
            times = _first_zeros(level, *path.T)
            wall = int(times.argmin())
            time = min(float(times[wall]), left)
            turn = np.array([[np.cos(time), -np.sin(time)], [np.sin(time), np.cos(time)]])
            place, velocity = turn.T @ np.stack([place, velocity])
            path, left = path @ turn, left - time
            if not left > 0:
                return np.asarray(posterior.mean + _from_deviations(posterior, place))
            if wall not in pushes:
                pushes[wall] = half.T @ half[:, wall]
            impulse = 2 * path[wall, 1] / pushes[wall][wall]
            velocity -= impulse * half[:, wall]
            path[:, 1] -= impulse * pushes[wall]

    def _in_deviations(self, posterior: Posterior) -> FloatArray:
        """Return the combinations as they are of y, real parts before imaginary ones, transposed, (n or 2 n, K)."""
        return _parts(solve_triangular(posterior.factor, self.rows.conj().T, lower=True, check_finite=False))


def _parts(values: Array) -> FloatArray:
    """Return real parts, and of complex values imaginary parts after them, along the first axis."""
    return np.concatenate([values.real, values.imag]) if np.iscomplexobj(values) else values


def _from_deviations(posterior: Posterior, y: FloatArray) -> Array:
    n = len(posterior.mean)
    white = y[:n] + 1j * y[n:] if posterior.is_complex else y
    return np.asarray(solve_triangular(posterior.factor, white, lower=True, trans="C", check_finite=False))


def _first_zeros(level: FloatArray, at: FloatArray, slope: FloatArray) -> FloatArray:
    """Return when level + at cos t + slope sin t comes down to zero first, (K,); infinite where it never does."""
    size = np.hypot(at, slope)
    reached: BoolArray = size > np.abs(level)
    times = np.full(len(level), np.inf)
    top, fall = np.arctan2(slope[reached], at[reached]), np.arccos(-level[reached] / size[reached])
    times[reached] = (top + fall) % (2 * np.pi)
    # What comes down reaches zero within half a period; by rounding it may have been there already.
    times[(slope < 0) & reached & (times > np.pi)] = 0.0
    return times
