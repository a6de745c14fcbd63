"""J0(u_k rho) for many u_k and many points at once, by a matrix product.

Neumann's addition theorem, for rho = sin(t/2) with 0 <= rho <= 1, reads

    J0(u rho) = J0(u/2)^2 + 2 sum_{n>=1} J_n(u/2)^2 cos(n t),

and cos(n t) = T_n(1 - 2 rho^2) are Chebyshev polynomials: one recurrence per point serves every u. The series
stops at rounding level shortly after n = u/2. Over a part of the disc, rho from a to b, so does the Chebyshev series of
that part shortly after n = u (b - a)/2; it follows from the values at its nodes.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import j0, j1, jn_zeros, jv

FloatArray = NDArray[np.float64]
Boundary = Literal["dirichlet", "neumann"]

# What the truncated tail of the series may add up to, in units of J0(0) = 1.
_TAIL = 1e-16
# Smaller coefficients are set to zero: denormal numbers would halve the speed of the product.
_NEGLIGIBLE = 1e-25
# Squares of radii so near to each other would be told apart by their rounding errors.
_NARROW = 1e-3
# Rows of Chebyshev polynomials made at a time.
_BLOCK = 20


def radial_zeros(k_max: int, boundary: Boundary) -> tuple[FloatArray, FloatArray]:
    """Return the radial frequencies u_k and norms q_k for k = 1..k_max, each (k_max,)."""
    if boundary == "dirichlet":
        u = jn_zeros(0, k_max)
        return u, j1(u) / np.sqrt(2)
    u = np.concatenate([[0.0], jn_zeros(1, k_max)])[:k_max]
    return u, np.abs(j0(u)) / np.sqrt(2)


class BesselRows:
    """The rows ``scale_k J0(u_k rho)``.

    Parameters
    ----------
    u : ndarray, (Nk,)
        Radial frequencies, not negative.
    scale : ndarray, (Nk,)
        Factor of each row.
    """

    def __init__(self, u: FloatArray, scale: FloatArray) -> None:
        self.u = np.asarray(u, dtype=float)
        self.scale = np.asarray(scale, dtype=float)
        order = np.arange(int(self.u.max() / 2) + 64)
        series = 2 * jv(order, self.u[:, None] / 2) ** 2
        series[:, 0] /= 2
        series[series < _NEGLIGIBLE] = 0
        tail = series[:, ::-1].cumsum(axis=1)[:, ::-1].max(axis=0)
        self.n_terms = max(2 * _BLOCK + 1, int(np.count_nonzero(tail > _TAIL)))
        self._table = np.ascontiguousarray(self.scale[:, None] * series[:, : self.n_terms])

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.u)

    def evaluate(self, rho_squared: FloatArray, out: FloatArray, work: FloatArray) -> None:
        """Fill ``out`` with the rows; the less the points' radii differ, the less it takes.

        Parameters
        ----------
        rho_squared : ndarray, (Npoints,)
            Beyond 1, where the series is not valid, J0 is computed directly, which is slow.
        out : ndarray, (Nk, Npoints), C order
            In single or double precision.
        work : ndarray, (n_terms, Npoints), C order
            Overwritten.
        """
        low, high = float(rho_squared.min(initial=1.0)), float(rho_squared.max(initial=0.0))
        if high > 1 + 1e-12:
            out[...] = self.scale[:, None] * j0(self.u[:, None] * np.sqrt(rho_squared))
            return
        table, n_here = self._table, self._terms_between(low, high)
        if n_here < min(self.n_terms, len(rho_squared)):
            table = self._table_between(low, high, n_here)
            rho_squared = np.clip((rho_squared - low) / (high - low), 0.0, 1.0)
        terms = work[: table.shape[1]]
        chebyshev(rho_squared, terms)
        np.dot(table.astype(out.dtype, copy=False), terms.astype(out.dtype, copy=False), out=out)

    def _terms_between(self, low: float, high: float) -> int:
        """Return how many terms bring the tail to rounding level between these squares of radii."""
        if high - low < _NARROW:
            return self.n_terms
        waves = 0.5 * float(self.u.max()) * (np.sqrt(high) - np.sqrt(low))
        return max(2 * _BLOCK + 1, int(waves + 7 * np.cbrt(waves) + 16))

    def _table_between(self, low: float, high: float, n_terms: int) -> FloatArray:
        """Return the coefficients of T_n(1 - 2 y) with y = (rho^2 - low) / (high - low), (Nk, n_terms)."""
        nodes, to_coefficients = _nodes(n_terms)
        at_nodes = np.empty((self.n_terms, n_terms))
        chebyshev(low + (high - low) * nodes, at_nodes)
        return np.asarray(self._table @ at_nodes @ to_coefficients)


@lru_cache(maxsize=64)
def _nodes(n_terms: int) -> tuple[FloatArray, FloatArray]:
    """Return the Chebyshev nodes in 0..1, (n,), and what turns values there into coefficients, (n, n)."""
    angle = (np.arange(n_terms) + 0.5) * np.pi / n_terms
    transform = 2 / n_terms * np.cos(angle[:, None] * np.arange(n_terms))
    transform[:, 0] /= 2
    return np.sin(angle / 2) ** 2, transform


def chebyshev(y: FloatArray, out: FloatArray) -> None:
    """Fill the rows of ``out`` with ``T_n(1 - 2 y)``, n = 0, 1, ....

    The first rows step by differences, d_n = T_{n+1} - T_n = d_{n-1} - 4 y T_n, which keeps full accuracy at
    y -> 0 where the usual recurrence loses n^2 roundings; the others follow in blocks,
    T_{n+h} = 2 T_h T_n - T_{n-h}.

    Parameters
    ----------
    y : ndarray, (Npoints,)
        Between 0 and 1.
    out : ndarray, (n_terms, Npoints), n_terms > 2 _BLOCK
    """
    four_y = 4 * y
    step = -0.5 * four_y
    term = np.empty_like(y)
    out[0] = 1
    np.add(out[0], step, out=out[1])
    for n in range(1, _BLOCK):
        np.multiply(four_y, out[n], term)
        np.subtract(step, term, step)
        np.add(out[n], step, out[n + 1])
    twice = 2 * out[_BLOCK]
    for start in range(_BLOCK + 1, len(out), _BLOCK):
        new = out[start : start + _BLOCK]
        size = len(new)
        np.multiply(out[start - _BLOCK : start - _BLOCK + size], twice, new)
        # The first block meets T_{-n} = T_n.
        first = start - 2 * _BLOCK
        np.subtract(new, out[first : first + size] if first > 0 else out[_BLOCK - 1 :: -1], new)


@lru_cache(maxsize=16)
def radial_rows(ks: tuple[int, ...], boundary: Boundary, norm: float) -> BesselRows:
    """Return the radial functions of these k times a norm; bases that are made again and again have them in common."""
    u, q = radial_zeros(max(ks), boundary)
    kept = np.array(ks) - 1
    return BesselRows(u[kept], norm / q[kept])
