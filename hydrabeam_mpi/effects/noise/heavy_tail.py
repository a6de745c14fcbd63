"""Whether a few of many residuals come from a broader distribution than noise, from a histogram of |z|^2.

Whitened residuals z of Gaussian noise have u = |z|^2 distributed as exp(-u). The alternative is that a fraction p of
the rows, at most 5%, have instead

    g(u) = S / (S + u)^2,

bursts of power E_1 S/E_2 with E_1 and E_2 exponential: of the scale S, but over several decades. The likelihood is that
of a histogram with fine bins.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.eigen import eigen

# Bins of |z|^2; the last has no end. Half of the good rows lie above 0.7, and one in 1e10 above 23.
EDGES: FloatArray = np.concatenate([[0.0], np.geomspace(0.05, 1e12, 241)])
LOG_EDGES: FloatArray = np.concatenate([[-np.inf], np.log(EDGES[1:])])
MAX_FRACTION = 0.05
MIN_SCALE, MAX_SCALE = 4.0, 1e9
# Good rows that masking may cost, of all rows of a channel.
GOOD_ROWS_LOST = 0.01
# By how much the log evidence must exceed that of a broader bulk.
MIN_GAIN = 3.0


class Mixture(NamedTuple):
    """Fit of one channel: parameters with errors, ln Bayes factor, gain in ln L, and why these are not outliers."""

    x: FloatArray
    std: FloatArray
    log_bayes_factor: float
    gain: float
    reason: str | None


def _log_bulk(scale: float) -> FloatArray:
    """Return ln probability of each bin for u / scale distributed as exp(-u)."""
    width = np.append(np.diff(EDGES[:-1]), np.inf)
    return np.asarray(-EDGES[:-1] / scale + np.log(-np.expm1(-width / scale)))


def log_broad(log_scale: float) -> FloatArray:
    """Return ln probability of each bin for the density S / (S + u)^2, which is S (b - a) / (S + a) (S + b), (Nbins,).

    The logarithms are added: a difference of the probabilities beyond either edge is zero where S is large.
    """
    beyond = np.logaddexp(log_scale, LOG_EDGES[:-1])
    inner = log_scale + np.log(np.diff(EDGES[:-1])) - beyond[:-1] - beyond[1:]
    return np.append(inner, log_scale - beyond[-1])


def _log_likelihood(counts: FloatArray, bulk: float, log_p: float, log_scale: float) -> float:
    """Return ln L of the mixture."""
    mixed = np.logaddexp(np.log1p(-np.exp(log_p)) + _log_bulk(bulk), log_p + log_broad(log_scale))
    return float(counts @ mixed)


def fit_mixture(counts: FloatArray, bulk: float) -> Mixture:
    """Fit fraction and scale of what is broad in one channel's histogram."""
    total = max(float(counts.sum()), 1.0)
    threshold = bulk * np.log(total / GOOD_ROWS_LOST)
    bounds = [(np.log(0.1 / total), np.log(MAX_FRACTION)), (np.log(MIN_SCALE), np.log(MAX_SCALE))]
    if bounds[0][0] >= bounds[0][1]:
        return Mixture(np.array([threshold, 0.0, MIN_SCALE]), np.zeros(3), 0.0, 0.0, None)
    starts = [(p, s) for p in np.linspace(*bounds[0], 12) for s in np.linspace(*bounds[1], 15)]
    start = max(starts, key=lambda at: _log_likelihood(counts, bulk, *at))
    found = minimize(lambda at: -_log_likelihood(counts, bulk, *at), start, method="Nelder-Mead", bounds=bounds)
    gain = float(-found.fun - counts @ _log_bulk(bulk))
    curvature = _hessian(lambda at: -_log_likelihood(counts, bulk, *at), found.x)
    values, vectors = eigen(curvature)
    # No error is wider than the prior, flat in the logarithms.
    values = np.maximum(values, 1 / max(high - low for low, high in bounds) ** 2)
    covariance = (vectors / values) @ vectors.T
    volume = float(np.prod([high - low for low, high in bounds]))
    occam = np.log(min(2 * np.pi * np.sqrt(np.prod(1 / values)) / volume, 1.0))
    fraction, scale = np.exp(found.x)
    x = np.array([threshold, fraction, scale])
    std = np.array([0.0, *np.exp(found.x) * np.sqrt(np.diag(covariance))])
    reason = None
    if fraction > 0.9 * MAX_FRACTION:
        reason = f"more than {fraction:.1%} of the rows stand out, which are not a few"
    elif _gain_over_broader_bulk(counts, found.x) + occam < MIN_GAIN:
        reason = "the rows are as a whole more scattered than noise, not a few of them"
    return Mixture(x, std, gain + occam, gain, reason)


def _gain_over_broader_bulk(counts: FloatArray, at: FloatArray) -> float:
    """Return how much ln L gains by outliers where the noise of all rows is free in either case."""

    def loss(values: FloatArray) -> float:
        return -_log_likelihood(counts, float(np.exp(values[0])), min(values[1], np.log(MAX_FRACTION)), values[2])

    def alone(values: FloatArray) -> float:
        return -float(counts @ _log_bulk(float(np.exp(values[0]))))

    mixed = minimize(loss, [0.0, *at], method="Nelder-Mead", options={"maxiter": 600})
    # Powers in logarithmic bins: their centres start the search for the scale of all rows near its end.
    centres = np.sqrt(np.maximum(EDGES[:-1], 0.01) * EDGES[1:])
    mean = np.log(counts @ centres / max(counts.sum(), 1.0))
    bulk = min((minimize(alone, [start], method="Nelder-Mead") for start in (0.0, mean)), key=lambda one: one.fun)
    return float(bulk.fun - mixed.fun)


def _hessian(function: Callable[[FloatArray], float], at: FloatArray, step: float = 1e-3) -> FloatArray:
    """Return second derivatives by central differences, (n, n)."""
    steps = step * np.eye(len(at))
    return np.array(
        [
            [
                (function(at + a + b) - function(at + a - b) - function(at - a + b) + function(at - a - b))
                / (4 * step**2)
                for b in steps
            ]
            for a in steps
        ]
    )
