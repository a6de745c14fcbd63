"""Parameters that belong to single times or baselines, which the fitted rows do not tell where these are held out.

What the rest of the model says of a held-out row is known up to the beam's errors, which are alike in all rows of a
time. So of the rows of a time these parameters are fitted with weights that know of that: else they would follow what
the beam has wrong.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hydrabeam_mpi.data.observation import BoolArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.fit.by_time import columns_by_time, of_baselines
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.grown import adds_coefficients
from hydrabeam_mpi.fit.marginal import in_parts
from hydrabeam_mpi.fit.state import Active, Estimate, Fitted, Values
from hydrabeam_mpi.fit.whitening import TimeWhitener
from hydrabeam_mpi.fit.whole_beams import with_whole_beams
from hydrabeam_mpi.mpi import allreduce_sum, together

LOCAL_STEPS = 4
"""Newton steps at most, each of which about squares what the one before has left: all else stays as it is."""
MOVED = 1e-3
"""Of their standard deviations, by which parameters move in the last step that is worth taking: as steps square what is
left, that is a millionth of these then."""


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


def fit_local(context: FitContext, fitted: Fitted, local: str, kept: BoolArray) -> tuple[Fitted, BoolArray]:
    """Fit the parameters that belong to held-out times or baselines, with all else as it is, on the rows ``kept``.

    Returns the fit and which of the parameters in use these are, (q,). Collective: all ranks of the grid.
    """
    # What effects add to the beams is as uncertain as the rest of these.
    whole = with_whole_beams(context, fitted)
    values, posteriors = whole.values, whole.fit.posteriors
    for _ in range(LOCAL_STEPS):
        step = _local_step(context, Estimate(values, posteriors), local, kept)
        values = step.values
        if step.moved < MOVED:
            break
    inside = [adds_coefficients(context.setup, one) for one in fitted.values.active]
    outside = ~np.repeat(inside, [one.size for one in fitted.values.active])
    free = np.zeros(len(outside), dtype=bool)
    free[outside] = step.free
    others = iter(values.active)
    pairs_of = zip(fitted.values.active, inside, strict=True)
    active = tuple(one if is_inside else next(others) for one, is_inside in pairs_of)
    pairs = zip(fitted.fit.covariances, context.channels, strict=True)
    covariances = tuple(with_own(covariance, free, step.covariances[number]) for covariance, number in pairs)
    fit = replace(fitted.fit, covariances=covariances)
    return replace(fitted, values=replace(fitted.values, active=active), fit=fit), free


def with_own(covariance: FloatArray, free: BoolArray, own: FloatArray) -> FloatArray:
    """Return the covariance, (q, q), where those that are ``free`` have one of their own, and none with others."""
    out = np.where(np.outer(~free, ~free), covariance, 0.0)
    out[np.ix_(free, free)] = own
    return np.asarray(out)


@dataclass(frozen=True)
class _LocalStep:
    """Where a step has led: the values, which parameters it has moved, (q,), and their covariances in each channel.

    ``moved`` is by how many standard deviations one of them moved at most.
    """

    values: Values
    free: BoolArray
    covariances: list[FloatArray]
    moved: float


def _local_step(context: FitContext, at: Estimate, local: str, kept: BoolArray) -> _LocalStep:
    """Take a Newton step of these parameters, with the beams as they are. Collective: all ranks of the grid."""
    x, shared = at.values.x, at.values.shared
    signals, scores = _local_sums(context, at, local, kept)
    of_kind = np.concatenate([np.full(one.size, one.effect.local == local) for one in at.values.active])
    free = of_kind & (np.diag(signals.sum(axis=0)) > 0)
    covariances, moved = [], 0.0
    for f in range(len(x)):
        signal = np.where(np.outer(shared, shared), signals.sum(axis=0), signals[f])[np.ix_(free, free)]
        score = np.where(shared, scores.sum(axis=0), scores[f])[free] + at.values.prior_score(f)[free]
        covariance = np.asarray(np.linalg.inv(signal + at.values.prior_precision(f)[np.ix_(free, free)]), dtype=float)
        step = covariance @ score
        x[f, free] += step
        covariances.append(covariance)
        moved = max(moved, float(np.max(np.abs(step) / np.sqrt(np.diag(covariance)), initial=0.0)))
    # Rank 0 says whether to go on, so that rounding cannot let ranks differ.
    return _LocalStep(at.values.at(x), free, covariances, context.grid.world.bcast(moved))


def _local_sums(context: FitContext, at: Estimate, local: str, kept: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Return what the held-out rows ``kept`` say, for all that is uncertain of the beam: information and score.

    Those of all channels, (Nfreqs, q, q) and (Nfreqs, q).
    """
    share = context.test
    with together(context.grid.world):
        rows, added = share.calibrated(at)
    rows = replace(rows, inv_noise_var=rows.inv_noise_var * kept)
    n_freqs, q = at.values.x.shape
    signals, scores = np.zeros((n_freqs, q, q)), np.zeros((n_freqs, q))
    chosen = [
        (one, span) for one, span in zip(at.values.active, at.values.spans, strict=True) if one.effect.local == local
    ]
    for channel, number in enumerate(context.channels):
        with together(context.grid.group):
            for span, block, design in share.row_blocks(channel, at, added[channel], rows):
                for t, (which, columns) in enumerate(_columns(block, chosen, number)):
                    by_beam = share.model_root(channel, span.start + t, at, design[t])
                    time = TimeWhitener.of(block.weights[t], block.member, by_beam)
                    white = in_parts(time.rows(np.column_stack([columns, block.residual[t]])))
                    signals[number][np.ix_(which, which)] += white[:, :-1].T @ white[:, :-1]
                    scores[number][which] += white[:, :-1].T @ white[:, -1]
    allreduce_sum(context.grid.world, signals)
    allreduce_sum(context.grid.world, scores)
    return signals, scores


def _columns(
    block: RowBlock, chosen: list[tuple[Active, slice]], channel: int
) -> Iterator[tuple[IntArray, NDArray[np.complex128]]]:
    """Yield for each time which of all parameters in use its rows tell of effects, and their columns, (Nbls, k)."""
    numbers = np.concatenate([np.arange(span.start, span.stop) for _, span in chosen])
    for parts in columns_by_time(block, [one for one, _ in chosen], channel):
        columns = of_baselines(parts, block.member).tocsc()
        told = np.flatnonzero(np.diff(columns.indptr))
        yield numbers[told], columns[:, told].toarray()
