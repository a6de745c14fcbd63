"""Held-out rows under the posterior predictive of beams and effects, whitened."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, hstack

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.fit.gauss_newton import FitContext, active_sums, current, place
from hydrabeam_mpi.fit.rank_data import KEPT_BYTES
from hydrabeam_mpi.fit.row_sums import active_names
from hydrabeam_mpi.fit.rows import Rows
from hydrabeam_mpi.fit.state import State
from hydrabeam_mpi.fit.whitening import SharedErrors, root_of, whiten_time
from hydrabeam_mpi.mpi import allreduce_sum, together

LOCAL_STEPS = 4
MAX_FOLLOWED = 2000
"""With more parameters than this only their own variances count, not how they vary together nor the beam that follows.

Without the beam predictions are the wider the more of an effect it absorbs.
"""
SHARED_BYTES = KEPT_BYTES / 4
"""Of the columns of all held-out rows of a rank, up to which what rows share of the effects' errors is whitened."""


@dataclass(frozen=True)
class Whitened:
    """A rank's held-out residuals over their predictive standard deviation.

    Attributes
    ----------
    z : ndarray of complex, (Nlocal, Ntimes, Nbls)
        Real and imaginary part each of variance one if the model is right; this rank group's channels.
    used : ndarray of bool, same shape
    share : ndarray, same shape
        The model's share of the predictive variance, mean of the two parts.
    model : ndarray of complex, same shape
        The prediction over the standard deviation of the noise of its parts; zero where there are no data.
    root : ndarray, same shape
        One over that standard deviation.
    log_spread : float
        Sum over all ranks of ln |1 + M| / 2, with M the predictions' covariance in units of the noise.
    n_shared : float
        Twice the sum of ``share`` over all ranks: how many fitted parameters the predictions feel.
    """

    z: ComplexArray
    used: NDArray[np.bool_]
    share: FloatArray
    model: ComplexArray
    root: FloatArray
    log_spread: float
    n_shared: float = 0.0


def whiten(context: FitContext, state: State) -> Whitened:
    """Predict the held-out rows. Collective: all ranks of the grid.

    Parameters that belong to single times or baselines are not told by the fitted rows where those times or baselines
    are held out. Then they are fitted on one half of the held-out rows and the other half is predicted, either way.
    """
    local = _untold(context, state)
    if local is None:
        return _with_total(context, _whiten(context, state))
    folds = _fold(context, local)
    result, spread = None, 0.0
    for fold in (0, 1):
        fitted = _fit_local(context, state, local, folds != fold)
        part = _whiten(context, fitted)
        if result is None:
            result = part
        chosen = np.broadcast_to(folds == fold, part.z.shape)
        for name in ("z", "used", "share", "model", "root"):
            getattr(result, name)[chosen] = getattr(part, name)[chosen]
        spread += 0.5 * part.log_spread
    assert result is not None
    return _with_total(context, replace(result, log_spread=spread))


def _with_total(context: FitContext, whitened: Whitened) -> Whitened:
    """Sum over ranks."""
    mine = np.array([2 * float(whitened.share[whitened.used].sum()), whitened.log_spread])
    allreduce_sum(context.grid.world, mine)
    return replace(whitened, n_shared=float(mine[0]), log_spread=float(mine[1]))


def _untold(context: FitContext, state: State) -> str | None:
    """Say which kind of held-out data active effects have parameters of their own for."""
    by_baselines = context.problem.job.holdout.kind == "baselines"
    kinds = {one.effect.local for one in state.active}
    if by_baselines:
        return "baselines" if "baselines" in kinds else None
    return "times" if "times" in kinds else None


def _fold(context: FitContext, local: str) -> NDArray[np.int64]:
    """Return which half each held-out row belongs to, broadcastable to (Ntimes, Nbls)."""
    if local == "times":
        return (context.test.rows.groups[context.test.rows.member] % 2)[np.newaxis, :]
    return (context.test.rows.tile.times % 2)[:, np.newaxis]


def _fit_local(context: FitContext, state: State, local: str, kept: NDArray[np.bool_]) -> State:
    """Fit the parameters that belong to held-out times or baselines, with all else as it is, on the rows ``kept``."""
    state = replace(state, active=[replace(one) for one in state.active], covariances=list(state.covariances))
    sizes = [len(one.used) for one in state.active]
    mine = np.repeat([one.effect.local == local for one in state.active], sizes)
    shared, prior_var = state.shared, state.prior_var
    for _ in range(LOCAL_STEPS):
        with together(context.grid.world):
            rows, added = context.test.calibrated(state)
        rows = replace(rows, inv_noise_var=rows.inv_noise_var * kept)
        signals = np.zeros((state.active[0].x.shape[0], len(prior_var), len(prior_var)))
        scores = np.zeros((len(signals), len(prior_var)))
        for channel, number in enumerate(context.channels):
            sums = active_sums(context, context.test, state, channel, rows, added).likelihood_alone(active_names(state))
            if context.grid.is_group_root:
                signals[number], scores[number] = sums.signal, sums.score
        allreduce_sum(context.grid.world, signals)
        allreduce_sum(context.grid.world, scores)
        x = current(state)
        std = np.concatenate([one.std[:, one.used] for one in state.active], axis=1)
        covariances = []
        for f in range(len(x)):
            own = mine & (np.diag(signals.sum(axis=0)) > 0)
            signal = np.where(np.outer(shared, shared), signals.sum(axis=0), signals[f])[np.ix_(own, own)]
            score = np.where(shared, scores.sum(axis=0), scores[f])[own] - x[f, own] / prior_var[own]
            covariance = np.linalg.inv(signal + np.diag(1 / prior_var[own]))
            x[f, own] += covariance @ score
            covariances.append((own, covariance))
        place(state, x, std)
    for channel, number in enumerate(context.channels):
        own, covariance = covariances[number]
        state.covariances[channel] = state.covariances[channel].copy()
        state.covariances[channel][own] = state.covariances[channel][:, own] = 0.0
        state.covariances[channel][np.ix_(own, own)] = covariance
    return state


def _whiten(context: FitContext, state: State) -> Whitened:
    """Whiten the rank's rows with the state's parameters. Collective: all ranks of `grid.group`."""
    share = context.test
    with together(context.grid.world):
        rows, added = share.calibrated(state)
    z, model, share_of_model = np.zeros_like(rows.data), np.zeros_like(rows.data), np.zeros(rows.data.shape)
    root = np.sqrt(2 * rows.inv_noise_var)
    log_spread = 0.0
    for channel in range(len(context.channels)):
        covariance = state.covariances[channel] if state.active else np.zeros((0, 0))
        errors = SharedErrors(covariance) if _is_shared(context, len(covariance)) else None
        own_root = np.zeros((0, 0)) if errors else _followed_root(covariance)
        with together(context.grid.world):
            for span, block, design in share.row_blocks(channel, state, added[channel], rows):
                model[channel, span] = root[channel, span] * block.vis
                felt = _felt(context, state, channel, block, design) if state.active else None
                for t, row in enumerate(range(span.start, span.stop)):
                    stack, weights = block.residual[t][:, np.newaxis], block.weights[t]
                    if felt is not None:
                        columns, own = next(felt)
                        if errors is not None:
                            stack = np.column_stack([stack, columns])
                        else:
                            variance = _variances(columns, own, own_root).mean(axis=0)
                            weights = weights / (1 + 2 * weights * variance)
                    white, share_of_model[channel, row], spread = whiten_time(
                        stack, weights, block.member, design[t], state.posteriors[channel]
                    )
                    log_spread += spread
                    z[channel, row] = white[:, 0]
                    if errors is not None:
                        errors.add(white[:, 0], white[:, 1:])
        if errors is not None:
            allreduce_sum(context.grid.group, errors.gram)
            allreduce_sum(context.grid.group, errors.projection)
            for row, change in enumerate(errors.changes()):
                z[channel, row] += change
            used = rows.inv_noise_var[channel] > 0
            n_used = int(context.grid.group.allreduce(np.count_nonzero(used)))
            share_of_model[channel] += errors.n_shared / (2 * max(n_used, 1))
            log_spread += errors.log_spread if context.grid.is_group_root else 0.0
    return Whitened(z, rows.inv_noise_var > 0, share_of_model, model, root, log_spread)


def _is_shared(context: FitContext, n_params: int) -> bool:
    """Whether rows are whitened by what they share of the effects' errors; the same on all ranks of `grid.group`."""
    rows = context.problem.test
    n_rows = len(rows.times) * len(rows.bls) / context.grid.group.size
    return 0 < n_params <= MAX_FOLLOWED and 16 * n_rows * n_params <= SHARED_BYTES


def _felt(
    context: FitContext, state: State, channel: int, block: RowBlock, design: NDArray[Any]
) -> Iterator[tuple[ComplexArray, FloatArray]]:
    """Yield how predictions feel the parameters of the effects, time after time.

    Yields
    ------
    felt : ndarray of complex, (Nbls, q)
        By each parameter, where the beam follows it. Empty with too many parameters.
    own : ndarray, (Nbls,)
        With too many what each by itself adds to a row's variance, mean of that of its real and its imaginary part.
    """
    covariance, number = state.covariances[channel], context.channels[channel]
    block.integrate_for([one.effect for one in state.active])
    columns = [(one, one.effect.columns(block, one.x[number])) for one in state.active]
    matrices = [(csr_array(made.matrix()[:, one.used]), made.by_group) for one, made in columns]
    followed = len(covariance) <= MAX_FOLLOWED
    for t in range(len(block.times)):
        parts = []
        for matrix, by_group in matrices:
            n_rows = matrix.shape[0] // len(block.times)
            part = matrix[t * n_rows : (t + 1) * n_rows]
            parts.append(part[block.member] if by_group else part)
        if not followed:
            widths, sparse = np.diag(covariance), hstack(parts, format="csr")
            yield np.zeros((len(block.bls), 0), dtype=complex), 0.5 * (abs(sparse).power(2) @ widths)
            continue
        felt = np.concatenate([part.toarray() for part in parts], axis=-1)
        beam = design[t] @ state.beam_response[channel]
        felt += (beam if state.posteriors[channel].is_complex else beam[0] + 1j * beam[1])[block.member]
        yield felt, np.zeros(len(block.bls))


def _followed_root(covariance: FloatArray) -> FloatArray:
    """Return the root of the covariance of parameters that beams follow; empty with too many."""
    return root_of(covariance) if len(covariance) <= MAX_FOLLOWED else np.zeros((0, 0))


def _variances(felt: ComplexArray, own: FloatArray, root: FloatArray) -> FloatArray:
    """Return the variance of rows' real and imaginary parts, (2, Nbls)."""
    half = felt @ root
    return own + np.stack([np.sum(part**2, axis=-1) for part in (half.real, half.imag)])


def variance_by_effects(context: FitContext, state: State, rows: Rows, added: ComplexArray) -> tuple[FloatArray, bool]:
    """Return what the effects' uncertainty adds to the variance of predictions of single held-out rows.

    Serial.

    Parameters
    ----------
    context : FitContext
    state : State
        Fitted.
    rows, added
        The rank's held-out rows as calibrated, and E.

    Returns
    -------
    variance : ndarray, (Nlocal, 2, Ntimes, Nbls)
        Of real and imaginary parts, Jy^2.
    with_beam : bool
        Whether that is with beams that follow the effects, so that it adds to the variance by beams that do not.
    """
    variance = np.zeros((len(context.channels), 2, *rows.data.shape[1:]))
    with_beam = len(state.prior_var) <= MAX_FOLLOWED
    for channel in range(len(context.channels) if state.active else 0):
        root = _followed_root(state.covariances[channel])
        for span, block, design in context.test.row_blocks(channel, state, added[channel], rows):
            for t, (felt, own) in enumerate(_felt(context, state, channel, block, design), start=span.start):
                variance[channel, :, t] = _variances(felt, own, root)
    return variance, with_beam
