"""The Newton step of all effects together, some parameters of which belong to one channel and some to all."""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.fit.state import Active, Values
from hydrabeam_mpi.inference.gaussian import Block, Gaussian, spans_of
from hydrabeam_mpi.inference.likelihood import Likelihood
from hydrabeam_mpi.inference.prior import Prior, precision_of

HELD = 1e10
"""Precision, in units of the prior's, with which degenerate combinations are held at zero."""
NOTHING = Gaussian((), np.zeros((0, 0)), np.zeros(0), None)
"""What is known of no unknowns at all."""


def solve_jointly(
    values: Values, likelihoods: list[Likelihood], damping: float = 0.0
) -> tuple[FloatArray, FloatArray, list[FloatArray], float, float]:
    """Take the Newton step of all active parameters in use.

    Those that belong to one channel alone are marginalised in it; what is then known of those that channels share, or
    that their prior couples, is put together, and the others follow, channel by channel, given these.

    Parameters
    ----------
    values : Values
        Where the parameters are.
    likelihoods : list of Likelihood
        Of each channel, linearised there, with the beam marginalised.
    damping : float
        By which the information of each parameter is larger than it is, in parts of itself (Marquardt 1963): steps get
        shorter, and turn to where the likelihood rises most.

    Returns
    -------
    x, std : ndarray, (Nfreqs, q)
    covariances : list of ndarray, (q, q)
    moved : float
        Largest step in standard deviations.
    gain : float
        By which the steps, before they are limited, raise ln(likelihood x prior) of the linear model.
    """
    n_freqs = len(likelihoods)
    own, common = [NOTHING] * n_freqs, NOTHING
    for name, one in values.blocks.items():
        for channels, prior in one.prior.pieces(n_freqs):
            held = _prior(name, one, channels, prior)
            if len(channels) == 1 and not one.prior.shared:
                own[channels[0]] *= held
            else:
                common *= held
    of_channels = []
    for f, likelihood in enumerate(likelihoods):
        blocks = tuple(_block(name, one, f) for name, one in values.blocks.items())
        information = likelihood.information + np.diag(damping * np.diag(likelihood.information))
        of_channels.append(Gaussian(blocks, information, likelihood.score, None) * own[f])
        common *= of_channels[f].marginalise([one.name for one in own[f].blocks])
    steps, covariances = zip(*(one.moments_given(common) for one in of_channels), strict=True)
    # Rounding may leave a variance of nearly nothing, as of what a very wide prior lets the beam be, below zero.
    std = np.sqrt([np.maximum(np.diag(one), 0.0) for one in covariances])
    new, moved, gain = _moved(values, np.array(steps), std, np.array([one.score for one in likelihoods]))
    return new, std, list(covariances), moved, gain


def solve_together(
    values: Values, information: FloatArray, scores: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, float, float]:
    """Take the same step where what is known of one channel's parameters depends on those of the others.

    Parameters
    ----------
    values : Values
    information : ndarray, (Nfreqs q, Nfreqs q)
        Of all channels' parameters, those of a channel side by side, with the beams marginalised.
    scores : ndarray, (Nfreqs, q)

    Returns
    -------
    x, std : ndarray, (Nfreqs, q)
    covariance : ndarray, (Nfreqs q, Nfreqs q)
    moved, gain : float
    """
    n_freqs = len(scores)
    each = [_block(name, one, f) for f in range(n_freqs) for name, one in values.blocks.items()]
    blocks = tuple(dict.fromkeys(each))
    spans = spans_of(blocks, in_parts=True)
    index = np.concatenate([np.arange(spans[one.name].start, spans[one.name].stop) for one in each])
    n = max(span.stop for span in spans.values())
    matrix, source = np.zeros((n, n)), np.zeros(n)
    np.add.at(matrix, (index[:, np.newaxis], index), information)
    np.add.at(source, index, scores.ravel())
    known = Gaussian(blocks, matrix, source, None)
    for name, one in values.blocks.items():
        for channels, prior in one.prior.pieces(n_freqs):
            known *= _prior(name, one, channels, prior)
    step, spread = known.moments
    covariance = spread[np.ix_(index, index)]
    std = np.sqrt(np.diag(covariance)).reshape(scores.shape)
    new, moved, gain = _moved(values, step[index].reshape(scores.shape), std, scores)
    return new, std, covariance, moved, gain


def _moved(values: Values, steps: FloatArray, std: FloatArray, scores: FloatArray) -> tuple[FloatArray, float, float]:
    """Return where steps lead, the largest in standard deviations, and their gain; (Nfreqs, q) each but the latter."""
    share = np.where(values.shared, 1 / len(steps), 1.0)
    pulls = [score + share * values.prior_score(f) for f, score in enumerate(scores)]
    gain = 0.5 * sum(float(step @ pull) for step, pull in zip(steps, pulls, strict=True))
    x = values.x
    new = x + np.array([limited(values, step) for step in steps])
    moved = np.divide(np.abs(new - x), std, out=np.zeros_like(std), where=std > 0)
    return new, float(np.max(moved, initial=0.0)), gain


def _block(name: str, one: Active, channel: int) -> Block:
    """Return the block of an effect's parameters in a channel; channels that share them have the same one."""
    return Block(name if one.prior.shared else f"{name} in channel {channel}", one.size)


def _prior(name: str, one: Active, channels: range, prior: Prior) -> Gaussian:
    """Return the prior of some channels' steps from where an effect is; what is degenerate is held at zero."""
    combinations = np.asarray(np.kron(np.eye(len(channels)), one.held), dtype=float)
    precision: FloatArray = precision_of(prior) + precision_of_held(combinations, prior.std())
    source = prior.precision_times(prior.mean) - precision @ one.x[channels][:, one.used].reshape(-1)
    return Gaussian(tuple(_block(name, one, f) for f in channels), precision, source, None)


def precision_of_held(combinations: FloatArray, std: FloatArray) -> FloatArray:
    """Return the precision, (n, n), with which ``combinations`` of unknowns, (k, n), are held at zero.

    In units of the prior's width, ``std``, and in the unknowns' own where that is flat.
    """
    weight = HELD / np.sum((combinations * np.where(np.isfinite(std), std, 1.0)) ** 2, axis=1)
    return np.asarray(combinations.T @ (weight[:, np.newaxis] * combinations))


def limited(values: Values, step: FloatArray) -> FloatArray:
    """Keep steps of strongly nonlinear parameters, such as positions, within their natural size."""
    limits = np.concatenate([np.zeros(0), *(one.step_limit[one.used] for one in values.active)])
    return np.clip(step, -limits, limits)
