"""Gaussians on the sky with the beam and the fringes over them.

With delta the place in the plane that touches the sky at the centre, q the baseline's part in that plane and w that
towards the centre, in wavelengths, and S the covariance of the Gaussian, a direction's phase is
2 pi (w + q.delta - w delta^2 / 2), as the sky is curved. The beam is B + g.delta + delta.H.delta / 2. So of the point's
fringe there is left

    G [B + 2 pi i u.g + tr(H V) / 2 - 2 pi^2 u.H.u],    G = exp(-2 pi^2 q.V.q) / sqrt(det M),    u = V q,    V = S N,

with M = 1 + 2 pi i w S and N = M^-1. As S changes by dS, V does by N dS N and ln det M by 2 pi i w tr(N dS). For a
source of a degree in the main lobe of a 14 m dish the slope's part is a sixth of B on a baseline of 100 m at 150 MHz.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydrabeam_mpi.data.observation import Array, ComplexArray, FloatArray
from hydrabeam_mpi.effects.interface.sources import Sources

LARGEST_LN = np.log(1e3)
"""Of a visibility over that of a point, from where a fit may start but does not stay."""
STEP = 1e-3
"""rad, of second derivatives of beams: with it a table's 1e-10 and the beam's fourth derivatives matter as little."""

Symmetric = Sequence[Array]
"""Matrices [[a, b], [b, d]] as a, b, d; broadcast against (Ngroups, Nsrc)."""


def of_point(
    sources: Sources, vectors: FloatArray, spread: Symmetric, changes: Sequence[Symmetric] | FloatArray
) -> ComplexArray:
    """Return what is to be multiplied with the fringes of points to have what Gaussians have more than these.

    Parameters
    ----------
    sources : Sources
        The centres.
    vectors : ndarray, (Ngroups, 3)
        Baselines in wavelengths.
    spread : Symmetric
        S of each, radians^2, along `Sources.tangents`: away from the zenith and around it.
    changes : sequence of Symmetric
        What S changes by with each parameter.

    Returns
    -------
    ndarray of complex, (1 + Nchanges, Ngroups, Nsrc)
        That, and its derivatives.
    """
    down, around = sources.tangents
    along = vectors @ sources.enu
    q = vectors @ down, vectors @ around
    if not np.any(spread):
        return _of_points(sources, along, q, changes)
    bend, (beam, g, h) = 2j * np.pi * along, _around(sources)
    a, b, d = spread
    det = (1 + bend * a) * (1 + bend * d) - (bend * b) ** 2
    inverse: Symmetric = ((1 + bend * d) / det, -bend * b / det, (1 + bend * a) / det)
    flat = bend * (a * d - b**2)
    v: Symmetric = ((a + flat) / det, b / det, (d + flat) / det)
    u, nq = _times(v, q), _times(inverse, q)
    hu = _times(h, u)
    exponent = -2 * np.pi**2 * _dot(q, u) - 0.5 * np.log(det)
    fading = np.exp(np.where(exponent.real > LARGEST_LN, LARGEST_LN, exponent))
    seen = beam + 2j * np.pi * _dot(u, g) + 0.5 * _trace(h, v) - 2 * np.pi**2 * _dot(u, hu)
    out = [fading * seen - beam]
    # N H N, of which the trace with dS is that of H with N dS N.
    curved = _twice(inverse, h)
    for change in changes:
        m = _times(change, nq)
        du = _times(inverse, m)
        fades = -2 * np.pi**2 * _dot(nq, m) - 0.5 * bend * _trace(inverse, change)
        further = 2j * np.pi * _dot(du, g) + 0.5 * _trace(curved, change) - 4 * np.pi**2 * _dot(du, hu)
        out.append(fading * (fades * seen + further))
    return np.stack(out)


def _of_points(
    sources: Sources, along: FloatArray, q: Sequence[FloatArray], changes: Sequence[Symmetric] | FloatArray
) -> ComplexArray:
    """Return the same where S is zero: all that sources have more then is what it changes by."""
    beam, g, h = _around(sources)
    out = np.zeros((1 + len(changes), *along.shape), dtype=complex)
    for part, change in zip(out[1:], changes, strict=True):
        m = _times(change, q)
        part.real = -2 * np.pi**2 * beam * _dot(q, m) + 0.5 * _trace(h, change)
        part.imag = 2 * np.pi * _dot(m, g) - np.pi * beam * along * (change[0] + change[2])
    return out


def _times(matrix: Symmetric, vector: Sequence[Array]) -> tuple[Array, Array]:
    (a, b, d), (x, y) = matrix, vector
    return a * x + b * y, b * x + d * y


def _dot(one: Sequence[Array], two: Sequence[Array]) -> Array:
    return np.asarray(one[0] * two[0] + one[1] * two[1])


def _trace(one: Symmetric, two: Symmetric) -> Array:
    """Return the trace of a product."""
    return np.asarray(one[0] * two[0] + 2 * one[1] * two[1] + one[2] * two[2])


def _twice(outer: Symmetric, inner: Symmetric) -> Symmetric:
    """Return outer inner outer."""
    first, second = _times(inner, outer[:2]), _times(inner, outer[1:])
    return _dot(outer[:2], first), _dot(outer[1:], first), _dot(outer[1:], second)


def _around(sources: Sources) -> tuple[FloatArray, tuple[FloatArray, FloatArray], Symmetric]:
    """Return the beam, (Nsrc,), and its slopes and second derivatives along the tangents."""
    down, around = sources.tangents

    def at(one: int, two: int) -> FloatArray:
        return sources.beam_at(sources.enu + STEP * (one * down + two * around))

    here, low, high, left, right = sources.beam, at(-1, 0), at(1, 0), at(0, -1), at(0, 1)
    across = 0.25 * (at(1, 1) - at(1, -1) - at(-1, 1) + at(-1, -1))
    slopes = (high - low) / (2 * STEP), (right - left) / (2 * STEP)
    return here, slopes, ((high - 2 * here + low) / STEP**2, across / STEP**2, (right - 2 * here + left) / STEP**2)
