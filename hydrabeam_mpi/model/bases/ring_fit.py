"""Fit of functions of radius and azimuth, each the product of two, to samples on rings of equal zenith angle.

They decouple into one small problem for every m, with two rules where a ring is too coarse for m. Both say that a beam
is smooth; without them plain least squares fits the samples as well but swings by more than the beam itself between the
few samples around the zenith, as J0(0) = 1 for every m:

- a ring of n azimuths has no component with |m| > n/2, and no say on |m| = n/2;
- where no sample is at the zenith, the beam there has no component with m != 0, with the weight of the
  innermost ring.

With at least 2 m_max + 1 azimuths on every ring and a ring at the zenith, neither rule is ever used. Where
azimuths are not quite equally spaced, each ring is fitted in azimuth first, and its coefficients in radius.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.model.bases.rings import RingGrid

RCOND = 1e-6
"""Relative size of the singular values that are treated as zero."""


def fit_rings(
    rings: RingGrid,
    modes: Sequence[tuple[int, int]],
    radial_functions: Callable[[FloatArray], FloatArray],
    norm_az: int,
    is_complex: bool,
) -> tuple[Array, int]:
    """Solve for the modes of each m on its own.

    Parameters
    ----------
    rings : RingGrid
    modes : sequence of (k, m)
        With exp(i m az), or cosine (m >= 0) and sine (m < 0) where they are not complex.
    radial_functions : callable
        From zenith angles, (N,), to the functions of k = 1, 2, ..., (k_max, N).
    norm_az : int
        Number of azimuths on which the azimuthal functions have unit norm.
    is_complex : bool

    Returns
    -------
    ndarray, (..., len(modes))
        Coefficients, of as many beams as the rings have values of.
    int
        Number of directions of coefficient space that the samples do not determine.
    """
    m_max = max(abs(m) for _, m in modes)
    za, n_az = rings.za, rings.n_az
    orders = np.sqrt(norm_az) * rings.azimuthal_orders(m_max)
    has_zenith = za[0] < 1e-6
    if not has_zenith:
        za = np.concatenate([[0.0], za])
        n_az = np.concatenate([n_az[:1], n_az])
        orders = np.concatenate([np.zeros_like(orders[..., :1, :]), orders], axis=-2)
    radial = radial_functions(za).T
    modes_of_m: dict[int, list[int]] = {}
    for n, (_, m) in enumerate(modes):
        modes_of_m.setdefault(m, []).append(n)

    factors: dict[Any, tuple[FloatArray, int]] = {}
    coeffs = np.zeros((*orders.shape[:-2], len(modes)), dtype=np.complex128 if is_complex else np.float64)
    n_cut = 0
    for m, members in modes_of_m.items():
        ks = np.array([modes[n][0] for n in members])
        weight = np.where(2 * abs(m) == n_az, 0.0, np.sqrt(n_az))
        if not has_zenith:
            weight[0] = np.sqrt(n_az[0]) if m else 0
        target = np.where(2 * abs(m) > n_az, 0, _order(orders, m, m_max, is_complex))
        key = (ks.tobytes(), weight.tobytes())
        if key not in factors:
            factors[key] = _pseudo_inverse(weight[:, None] * radial[:, ks - 1])
        inverse, cut = factors[key]
        coeffs[..., members] = (weight * target) @ inverse.T
        n_cut += cut
    return coeffs, n_cut


def _order(orders: Array, m: int, m_max: int, is_complex: bool) -> Array:
    """Return the radial profile that the modes of m must follow, (..., Nrings)."""
    if is_complex:
        return orders[..., m_max + m]
    if m == 0:
        return orders[..., m_max].real
    profile = orders[..., m_max + abs(m)]
    return np.sqrt(2) * (profile.real if m > 0 else -profile.imag)


def _pseudo_inverse(matrix: FloatArray) -> tuple[FloatArray, int]:
    u, s, vt = np.linalg.svd(matrix, full_matrices=False)
    keep = s > RCOND * s[0]
    return (vt[keep].T / s[keep]) @ u[:, keep].T, matrix.shape[1] - int(keep.sum())
