"""The Newton step of all effects together, some parameters of which belong to one channel and some to all."""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.fit.state import Values
from hydrabeam_mpi.inference.likelihood import Likelihood

HELD = 1e10
"""Precision, in units of the prior's, with which degenerate combinations are held at zero."""


def solve_jointly(
    values: Values, likelihoods: list[Likelihood]
) -> tuple[FloatArray, FloatArray, list[FloatArray], float]:
    """Take the Newton step of all active parameters in use.

    Parameters that channels share are solved for together, the others channel by channel given those.

    Parameters
    ----------
    values : Values
        Where the parameters are.
    likelihoods : list of Likelihood
        Of each channel, linearised there, with the beam marginalised.

    Returns
    -------
    x, std : ndarray, (Nfreqs, q)
    covariances : list of ndarray, (q, q)
    moved : float
        Largest step in standard deviations.
    """
    x, shared = values.x, values.shared
    s, p = np.flatnonzero(shared), np.flatnonzero(~shared)
    top, gradient = np.zeros((len(s), len(s))), np.zeros(len(s))
    channels = []
    for f, likelihood in enumerate(likelihoods):
        width = _units(values, f)
        prior, pull = _prior(values, f, width)
        if f == 0:
            top, gradient = prior[np.ix_(s, s)].copy(), pull[s].copy()
        matrix = width[:, np.newaxis] * likelihood.information * width
        score = width * likelihood.score
        own = np.linalg.inv(matrix[np.ix_(p, p)] + prior[np.ix_(p, p)])
        across = matrix[np.ix_(s, p)] @ own
        own_score = score[p] + pull[p]
        top += matrix[np.ix_(s, s)] - across @ matrix[np.ix_(p, s)]
        gradient += score[s] - across @ own_score
        channels.append((width, own, across, own_score))
    common = np.linalg.inv(top)
    common_step = common @ gradient
    new, std, covariances = x.copy(), np.zeros_like(x), []
    for f, (width, own, across, own_score) in enumerate(channels):
        step, covariance = np.zeros(len(width)), np.zeros((len(width), len(width)))
        step[s], step[p] = common_step, own @ own_score - across.T @ common_step
        covariance[np.ix_(s, s)] = common
        covariance[np.ix_(p, s)] = -across.T @ common
        covariance[np.ix_(s, p)] = covariance[np.ix_(p, s)].T
        covariance[np.ix_(p, p)] = own + across.T @ common @ across
        covariances.append(width[:, np.newaxis] * covariance * width)
        std[f] = np.sqrt(np.diag(covariances[-1]))
        new[f] += _limited(values, width * step)
    return new, std, covariances, float(np.max(np.abs(new - x) / std, initial=0.0))


def _units(values: Values, channel: int) -> FloatArray:
    """Return the widths of the prior in a channel, (q,), and the parameters' own units where it is flat."""
    std = values.prior_std(channel)
    return np.where(np.isfinite(std), std, 1.0)


def _prior(values: Values, channel: int, width: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the prior's precision (q, q) and score (q,) in units of ``width``; what is degenerate is held at zero."""
    precision = width[:, np.newaxis] * values.prior_precision(channel) * width
    to_mean = precision @ (values.prior_mean(channel) / width)
    for one, span in zip(values.active, values.spans, strict=True):
        for combination in one.degenerate_directions[:, one.used] * width[span]:
            precision[span, span] += HELD * np.outer(combination, combination) / np.vdot(combination, combination)
    return precision, to_mean - precision @ (values.x[channel] / width)


def _limited(values: Values, step: FloatArray) -> FloatArray:
    """Keep steps of strongly nonlinear parameters, such as positions, within their natural size."""
    limits = np.concatenate([np.zeros(0), *(one.step_limit[one.used] for one in values.active)])
    return np.clip(step, -limits, limits)
