"""Residuals whitened by their predictive distribution.

What the model is uncertain of is the same for redundant baselines and alike for others, so that a prediction that is off
is off for many rows at once. Dividing each row by its own standard deviation would leave that in, and chi^2 would be far
more uncertain than that of independent data. Of the rows of one time the part that the members of each group have in
common is therefore whitened together with that of the other groups, by the symmetric root, which changes a row as little
as whitening can.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.infer.posterior import Posterior


def whiten_time(
    residual: ComplexArray, weights: FloatArray, member: IntArray, design: NDArray[Any], posterior: Posterior
) -> tuple[ComplexArray, FloatArray]:
    """Whiten the rows of one time.

    Parameters
    ----------
    residual : ndarray of complex, (Nbls,)
        Data minus prediction, Jy.
    weights : ndarray, (Nbls,)
        Inverse variance of all that is each row's own, Jy^-2; zero for rows that do not count.
    member : ndarray of int, (Nbls,)
        Which design row belongs to each.
    design : ndarray
        (2, Ngroups, n) real and imaginary parts for real coefficients, or (Ngroups, n) for complex ones.
    posterior : Posterior
        Of the coefficients.

    Returns
    -------
    z : ndarray of complex, (Nbls,)
        Real and imaginary parts of variance one.
    share : ndarray, (Nbls,)
        The model's share of the variance.
    """
    n_groups = design.shape[-2]
    group_weights = np.bincount(member, weights, n_groups)
    used = np.flatnonzero(group_weights)
    root = np.sqrt(2 * group_weights[used])
    # Unit vector of what a group's members have in common, and the residual's component along it.
    own = np.sqrt(weights / np.where(group_weights > 0, group_weights, 1.0)[member])
    plain = np.sqrt(2 * weights) * residual
    common = np.bincount(member, own * plain.real, n_groups) + 1j * np.bincount(member, own * plain.imag, n_groups)
    variance = np.tile(root, 2)[:, np.newaxis] * _model_variance(posterior, design, used) * np.tile(root, 2)
    values, vectors = np.linalg.eigh(variance)
    values = np.maximum(values, 0.0)
    parts = np.concatenate([common[used].real, common[used].imag])
    whitened = vectors @ ((vectors.T @ parts) / np.sqrt(1 + values))
    change = np.zeros(n_groups, dtype=complex)
    change[used] = whitened[: len(used)] + 1j * whitened[len(used) :] - common[used]
    shared = np.zeros(n_groups)
    by_part = np.square(vectors) @ (values / (1 + values))
    shared[used] = 0.5 * (by_part[: len(used)] + by_part[len(used) :])
    return plain + own * change[member], own**2 * shared[member]


def _model_variance(posterior: Posterior, design: NDArray[Any], used: IntArray) -> FloatArray:
    """Return the covariance of the predictions' parts, real parts of all groups before imaginary ones, (2N, 2N)."""
    rows = design[..., used, :]
    if not posterior.is_complex:
        half = solve_triangular(posterior.factor, rows.reshape(2 * len(used), -1).T, lower=True, check_finite=False)
        return np.asarray(half.T @ half)
    half = solve_triangular(posterior.factor, rows.conj().T, lower=True, check_finite=False)
    circular = half.conj().T @ half
    return 0.5 * np.block([[circular.real, -circular.imag], [circular.imag, circular.real]])
