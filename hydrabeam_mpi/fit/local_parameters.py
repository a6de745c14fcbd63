"""Parameters that belong to single times or baselines, which the fitted rows do not tell where these are held out.

They are fitted on a part of the held-out rows, to predict the others.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hydrabeam_mpi.data.observation import BoolArray, FloatArray
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.linearised import active_sums
from hydrabeam_mpi.fit.state import Estimate, Fitted, Values
from hydrabeam_mpi.mpi import allreduce_sum, together

LOCAL_STEPS = 4
"""Newton steps, each of which about squares what the one before has left: all else stays as it is."""


def untold(context: FitContext, values: Values) -> str | None:
    """Say for which kind of held-out data (times or baselines) active effects have parameters of their own."""
    by_baselines = context.problem.job.holdout.kind == "baselines"
    kinds = {one.effect.local for one in values.active}
    if by_baselines:
        return "baselines" if "baselines" in kinds else None
    return "times" if "times" in kinds else None


def fold_of(context: FitContext, local: str) -> NDArray[np.int64]:
    """Return which half each held-out row belongs to, broadcastable to (Ntimes, Nbls)."""
    if local == "times":
        return (context.test.rows.groups[context.test.rows.member] % 2)[np.newaxis, :]
    return (context.test.rows.tile.times % 2)[:, np.newaxis]


def fit_local(context: FitContext, fitted: Fitted, local: str, kept: BoolArray) -> Fitted:
    """Fit the parameters that belong to held-out times or baselines, with all else as it is, on the rows ``kept``."""
    values, posteriors = fitted.values, fitted.fit.posteriors
    for _ in range(LOCAL_STEPS):
        values, found = _local_step(context, Estimate(values, posteriors), local, kept)
    covariances = []
    for covariance, number in zip(fitted.fit.covariances, context.channels, strict=True):
        free, own = found[number]
        known = ~free
        covariance = np.where(np.outer(known, known), covariance, 0.0)
        covariance[np.ix_(free, free)] = own
        covariances.append(covariance)
    return replace(fitted, values=values, fit=replace(fitted.fit, covariances=tuple(covariances)))


def _local_step(
    context: FitContext, at: Estimate, local: str, kept: BoolArray
) -> tuple[Values, list[tuple[BoolArray, FloatArray]]]:
    """Take a Newton step of these parameters, with the beams as they are.

    Returns
    -------
    values : Values
    found : list
        For each of the job's channels which parameters have been fitted, (q,), and their covariance.
    """
    x, shared = at.values.x, at.values.shared
    signals, scores = _local_sums(context, at, kept)
    of_kind = np.concatenate([np.full(len(one.used), one.effect.local == local) for one in at.values.active])
    free = of_kind & (np.diag(signals.sum(axis=0)) > 0)
    found: list[tuple[BoolArray, FloatArray]] = []
    for f in range(len(x)):
        signal = np.where(np.outer(shared, shared), signals.sum(axis=0), signals[f])[np.ix_(free, free)]
        score = np.where(shared, scores.sum(axis=0), scores[f])[free] + at.values.prior_score(f)[free]
        covariance = np.asarray(np.linalg.inv(signal + at.values.prior_precision(f)[np.ix_(free, free)]), dtype=float)
        x[f, free] += covariance @ score
        found.append((free, covariance))
    return at.values.at(x), found


def _local_sums(context: FitContext, at: Estimate, kept: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Return what the held-out rows ``kept`` say, with the beams as they are: information and score of all channels."""
    with together(context.grid.world):
        rows, added = context.test.calibrated(at)
    rows = replace(rows, inv_noise_var=rows.inv_noise_var * kept)
    n_freqs, q = at.values.x.shape
    signals, scores = np.zeros((n_freqs, q, q)), np.zeros((n_freqs, q))
    for channel, number in enumerate(context.channels):
        sums = active_sums(context, context.test, at, channel, rows, added[channel], at.values.blocks)
        if context.grid.is_group_root:
            likelihood = sums.likelihood_alone(list(at.values.blocks))
            signals[number], scores[number] = likelihood.signal, likelihood.score
    allreduce_sum(context.grid.world, signals)
    allreduce_sum(context.grid.world, scores)
    return signals, scores
