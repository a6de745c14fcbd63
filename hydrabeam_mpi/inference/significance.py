"""Significances as Gaussian equivalents, from p-values that may be far smaller than any number of double precision."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from hydrabeam_mpi.data.observation import Array, FloatArray

SMALLEST_LOG_P = -600.0  # log of p-values below which the distribution functions of scipy underflow
SIGNIFICANT_P = 1e-3
"""Probability, corrected for the number of looks, below which a structure is taken as real.

One data set in a thousand without any error still has one.
"""
LARGEST = 1e9  # bound of significances, so that what is written is finite


def chi2_sigma(chi2: ArrayLike, dof: ArrayLike) -> FloatArray:
    """Return how many standard deviations of a Gaussian are as improbable as a value of chi^2.

    Parameters
    ----------
    chi2, dof : array_like
        The degrees of freedom need not be whole.

    Returns
    -------
    ndarray
        Positive for an excess, negative for a deficit; N(0, 1) under the null. Zero with no degrees of freedom.
    """
    chi2, dof = np.broadcast_arrays(np.asarray(chi2, dtype=float), np.asarray(dof, dtype=float))
    known = dof > 0
    chi2, dof = np.maximum(chi2, 1e-300), np.where(known, dof, 1.0)
    above, below = special.chdtrc(dof, chi2), special.chdtr(dof, chi2)
    tail = np.where(chi2 > dof, above, below)
    far = ~((tail > np.exp(SMALLEST_LOG_P)) & (tail < 1 - 1e-12)) & (chi2 != dof)
    # Saddlepoint approximation (Barndorff-Nielsen's r*), whose error vanishes far out in either tail.
    ratio = np.where(far, chi2 / dof, 2.0)
    root = np.sign(ratio - 1) * np.sqrt(dof * (ratio - 1 - np.log(ratio)))
    root_star = root + np.log((ratio - 1) * np.sqrt(dof / 2) / root) / root
    sigma = np.where(far, root_star, _from_tails(above, below))
    return np.clip(np.where(known, sigma, 0.0), -LARGEST, LARGEST)


def f_sigma(ratio: float, dof: tuple[float, float]) -> float:
    """Return the Gaussian equivalent of a ratio of two reduced chi^2 with these degrees of freedom.

    Where p-values underflow it is the signed root of the likelihood ratio, which is right to a per cent.
    """
    above, below = float(special.fdtrc(*dof, ratio)), float(special.fdtr(*dof, ratio))
    if above > np.exp(SMALLEST_LOG_P) and below > np.exp(SMALLEST_LOG_P):
        return float(_from_tails(np.array(above), np.array(below)))
    first, total = dof[0], sum(dof)
    ratio = max(ratio, 1e-300)
    log_likelihood = total * np.log((first * ratio + dof[1]) / total) - first * np.log(ratio)
    return float(np.clip(np.sign(ratio - 1) * np.sqrt(max(log_likelihood, 0.0)), -LARGEST, LARGEST))


def correlation_sigma(correlation: float, n_pairs: float) -> float:
    """Return the Gaussian equivalent of a correlation between circular complex numbers (Fisher's z)."""
    return float(np.arctanh(np.clip(correlation, -1 + 1e-12, 1 - 1e-12)) * np.sqrt(max(2 * n_pairs - 1, 0.0)))


def kurtosis_sigma(kurtosis: float, n: float) -> float:
    """Return the Gaussian equivalent of n Sum |z|^4 / (Sum |z|^2)^2 - 2, whatever the scale of n circular complex z.

    Its variance is 4/n and its skewness 10/sqrt(n) for Gaussian z; it is taken as a shifted gamma distribution.
    """
    shape = 4 * n / 100  # of the gamma distribution with that skewness
    return float(chi2_sigma(2 * (shape + np.sqrt(shape) * kurtosis * np.sqrt(n) / 2), 2 * shape))


def log_p_two_sided(sigma: ArrayLike) -> FloatArray:
    """Return the natural log of the probability of as large a significance of either sign.

    The result has the shape of ``sigma``.
    """
    return np.minimum(np.log(2) + special.log_ndtr(-np.abs(np.asarray(sigma, dtype=float))), 0.0)


def log_p_of_looks(log_p: float, n_looks: float) -> float:
    """Return the natural log of the probability that the best of some independent looks has such a p-value."""
    if log_p + np.log(n_looks) < -30:
        return float(log_p + np.log(n_looks))
    if log_p > -1e-15:
        return 0.0
    return float(np.log(-np.expm1(n_looks * np.log1p(-np.exp(log_p)))))


def sigma_of_log_p(log_p: float) -> float:
    """Return the Gaussian equivalent of a one-sided p-value given by its natural log."""
    return float(-special.ndtri_exp(min(log_p, -1e-300)))


def _from_tails(above: Array, below: Array) -> FloatArray:
    """Return Gaussian equivalents from both tails' probabilities, of which the smaller one is accurate."""
    return np.where(above < below, -special.ndtri(above), special.ndtri(below))
