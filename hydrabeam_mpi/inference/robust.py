"""What stands out among many, and which of two spreads a number is from: robust, and with probabilities."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import stdtr

from hydrabeam_mpi.data.observation import BoolArray, FloatArray, IntArray

ABSURD_P = 1e-6
"""Probability, corrected for the number of looks, below which an antenna, time or baseline is not one of the others.

Of a million healthy data sets one loses data.
"""
POWER_SPREAD = 0.5
"""Spread of ln power that calibration errors, noise levels and beams cause, and effects describe: 25% in amplitude."""
LEAST_COUNT = 5
"""Of fewer values a median and its spread say nothing about one of them."""
GAUSSIAN = 1.4826
"""Standard deviation of a Gaussian over its median absolute deviation."""
MEDIAN_DOF = 0.37
"""Degrees of freedom, for each value, of a variance that is known by a median absolute deviation."""
LOG_MEAN = -0.5772156649015329
"""Mean of the log of an exponential of mean one, which |noise|^2 over its expectation is: minus Euler's constant."""
LOG_STD = np.pi / np.sqrt(6)
"""Standard deviation of the same."""
MEDIAN_WORTH = 2 / np.pi
"""Of a mean of as many Gaussian values, a median's."""
MOST_EXCEPTIONS = 0.25
"""Of more times, antennas or baselines than this share none is an exception."""
STRONG = 5.0
"""Log of the odds that make a claim: 150 to 1, so that prior odds against it of some tens leave it likely."""


def known_median(values: FloatArray) -> float:
    """Return the median of those values, (N,), that are no NaN; NaN where there are none."""
    known = values[~np.isnan(values)]
    return float(np.median(known)) if known.size else np.nan


def medians_of_antennas(values: FloatArray, n: FloatArray, ends: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return medians over each antenna's baselines, and the numbers of rows that they are worth, both (K, Nants).

    It takes half of an antenna's baselines to move them: a few that are bad, or those with an antenna that is, do not.

    Parameters
    ----------
    values, n : ndarray, (K, Nbls)
        Of each baseline, NaN where nothing is known, and of how many rows.
    ends : ndarray of int, (Nbls, 2)
        Its antennas.
    """
    of_antennas = [np.flatnonzero((ends == ant).any(axis=1)) for ant in range(int(ends.max()) + 1)]
    medians = np.array([[known_median(one[mine]) for mine in of_antennas] for one in values])
    return medians, MEDIAN_WORTH * np.array([[one[mine].sum() for mine in of_antennas] for one in n])


def beside_median(values: FloatArray) -> FloatArray:
    """Return values of several kinds, (Nkinds, N), less the median of their kind; NaN where nothing is known."""
    return np.asarray(values - np.array([[known_median(one)] for one in values]))


def outliers(values: FloatArray, error: ArrayLike = 0.0, spread: float = POWER_SPREAD) -> FloatArray:
    """Return how many standard deviations each value is from the median, zero where that is nothing absurd.

    Parameters
    ----------
    values : ndarray, (N,)
        NaN where nothing is known; -inf stands out.
    error : array_like
        Of each value, from noise.
    spread : float
        Of healthy values, which is added to what they show (their median absolute deviation).

    Returns
    -------
    ndarray, (N,)
        Absurd are those whose two-sided probability, times their number, is below `ABSURD_P`: by Student's
        distribution, with as many degrees of freedom as the variance is known to (Welch and Satterthwaite).
    """
    known = ~np.isnan(values)
    if np.count_nonzero(known) < LEAST_COUNT:
        return np.zeros(len(values))
    centre = known_median(values)
    if not np.isfinite(centre):
        return np.zeros(len(values))
    away = np.where(known, values - centre, 0.0)
    scatter = GAUSSIAN * float(np.median(np.abs(away[known])))
    variance = scatter**2 + spread**2 + np.asarray(error) ** 2
    sigma = away / np.sqrt(variance)
    n = np.count_nonzero(known)
    dof = MEDIAN_DOF * n * (variance / np.maximum(scatter**2, 1e-9 * variance)) ** 2
    absurd: BoolArray = 2 * n * stdtr(dof, -np.abs(sigma)) < ABSURD_P
    return np.where(absurd, sigma, 0.0)


def centre_and_spread(values: FloatArray) -> tuple[float, float]:
    """Return the median of values (N,), and the standard deviation of a Gaussian with their median deviation."""
    centre = float(np.median(values))
    return centre, GAUSSIAN * float(np.median(np.abs(values - centre)))


def log_odds_of_wide(value: float, error: float, narrow: float, wide: float) -> float:
    """Return the log Bayes factor of a Gaussian of width ``wide`` about zero over one of width ``narrow``.

    Parameters
    ----------
    value, error : float
        What was measured, and its standard deviation.
    narrow, wide : float
        Standard deviations of the two priors.
    """
    log_density = [-0.5 * (np.log(width**2 + error**2) + value**2 / (width**2 + error**2)) for width in (narrow, wide)]
    return float(log_density[1] - log_density[0])
