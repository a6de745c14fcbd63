"""The gains of antennas with which a model comes nearest to the data: calibration."""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray, IntArray

MOST_ITERATIONS = 200
STILL = 1e-10
"""Relative change of the gains by which they have converged."""


def solved_gains(overlap: ComplexArray, model: FloatArray, ends: IntArray, n_antennas: int) -> ComplexArray:
    """Return the gains g that leave least of data d = g_j g_k* m, (n_antennas,); the mean of their phases is zero.

    Each antenna's gain is the best given the others', in turns, of which every second one goes half way (Salvini and
    Wijnholds 2014, A&A 571, A97). They begin with the phases of the largest eigenvector of w d m*: with a right model
    this is a matrix of positive numbers but for the phases of both antennas, whatever these are.

    Parameters
    ----------
    overlap, model : ndarray, (Nbls,)
        Sums of w d m* and of w |m|^2 of each baseline.
    ends : ndarray of int, (Nbls, 2)
        Its antennas, below ``n_antennas``. Those without data have a gain of one.
    """
    first, second = ends.T
    products, powers = np.zeros((n_antennas, n_antennas), dtype=complex), np.zeros((n_antennas, n_antennas))
    products[first, second], products[second, first] = overlap, overlap.conj()
    powers[first, second] = powers[second, first] = model
    known = powers.any(axis=1)
    if not known.any():
        return np.ones(n_antennas, dtype=complex)
    gains = np.exp(1j * np.angle(np.linalg.eigh(products)[1][:, -1]))
    for number in range(MOST_ITERATIONS):
        norm = powers @ np.abs(gains) ** 2
        best = np.divide(products @ gains, norm, out=np.ones_like(gains), where=norm > 0)
        moved = np.linalg.norm(best - gains) / np.linalg.norm(best)
        gains = best if number % 2 == 0 else 0.5 * (best + gains)
        if moved < STILL:
            break
    phases = gains[known] / np.maximum(np.abs(gains[known]), np.finfo(float).tiny)
    return np.where(known, gains * np.exp(-1j * np.angle(np.sum(phases))), 1.0)
