"""Held-out rows under the posterior predictive of beams and effects, whitened."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hydrabeam_mpi.data.observation import Array, BoolArray, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.fit.by_time import columns_by_time, of_baselines
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.local_parameters import fit_local, fold_of, untold
from hydrabeam_mpi.fit.room import COMPLEX, KEPT_BYTES
from hydrabeam_mpi.fit.rows import Rows
from hydrabeam_mpi.fit.shared_errors import Felt, SharedErrors, whitening_coefficients
from hydrabeam_mpi.fit.state import Fitted
from hydrabeam_mpi.fit.whitening import TimeWhitener, root_of
from hydrabeam_mpi.fit.whole_beams import with_whole_beams
from hydrabeam_mpi.mpi import together

MAX_FOLLOWED = 2000
"""With more parameters than this only their variances count, not their covariances nor the response of the beam.

Without the response of the beam, predictions get the wider the more of an effect the beam absorbs.
"""
SHARED_BYTES = KEPT_BYTES / 2
"""Errors of the effects shared by rows are whitened if the columns of their held-out rows take less than this.

On all ranks together, as the same is to be predicted on any number of them.
"""

HELDOUT = "held-out rows"
"""Name of their predictions among what is kept of fits."""


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
    power : ndarray, same shape
        |d - C (A b + E)|^2, Jy^2 of the data as read: not divided by an effect's gain C.
    noise : ndarray, same shape
        Variance of the noise of these data by the weights of the model, Jy^2; zero where they do not count.
    uncertain : ndarray, same shape
        Variance by what is uncertain of the beam and of the effects, in the same Jy^2.
    n_shared : float
        Twice the sum of ``share`` over all ranks: how many fitted parameters the predictions feel.
    """

    z: ComplexArray
    used: BoolArray
    share: FloatArray
    model: ComplexArray
    root: FloatArray
    power: FloatArray
    noise: FloatArray
    uncertain: FloatArray
    n_shared: float = 0.0


def whiten(context: FitContext, fitted: Fitted) -> Whitened:
    """Predict the held-out rows. Collective: all ranks of the grid.

    Parameters that belong to single times or baselines are not told by the fitted rows where those times or baselines
    are held out. Then they are fitted on one half of the held-out rows and the other half is predicted, either way.
    """
    return context.of_latest(HELDOUT, fitted, lambda: _with_total(context, _predict(context, fitted)))


def hold_prediction(context: FitContext, fitted: Fitted) -> None:
    """Keep the prediction of the held-out rows by a fit while those of others are looked at."""
    context.hold(HELDOUT, fitted)


def _predict(context: FitContext, fitted: Fitted) -> Whitened:
    """Predict the rank's held-out rows. Collective: all ranks of the grid."""
    if not _is_over_channels(context, fitted):
        fitted = with_whole_beams(context, fitted)
    local = untold(context, fitted.values)
    if local is None:
        return _whiten(context, fitted)
    folds = fold_of(context, local)
    one, two = (_whiten(context, fit_local(context, fitted, local, without=fold)[0]) for fold in (0, 1))

    def of_either(name: str) -> Array:
        return np.where(folds == 0, getattr(one, name), getattr(two, name))

    names = ("z", "used", "share", "model", "root", "power", "noise", "uncertain")
    rows: dict[str, Any] = {name: of_either(name) for name in names}
    return Whitened(**rows)


def _with_total(context: FitContext, whitened: Whitened) -> Whitened:
    """Sum over ranks."""
    n_shared = context.grid.world.allreduce(2 * float(whitened.share[whitened.used].sum()))
    return replace(whitened, n_shared=n_shared)


def _whiten(context: FitContext, fitted: Fitted) -> Whitened:
    """Whiten the rank's rows with what has been fitted. Collective: all ranks of the grid."""
    share, has_effects = context.test, bool(fitted.values.active)
    with together(context.grid.world):
        rows, added = share.calibrated(fitted.estimate)
    root, noise = np.sqrt(2 * rows.inv_noise_var), share.noise_variance(rows)
    z, model = np.zeros_like(rows.data), np.zeros_like(rows.data)
    share_of_model, power, uncertain = np.zeros((3, *noise.shape))
    is_shared, errors_of = _is_shared(context, fitted), list[SharedErrors]()
    shared = fitted.values.shared & _is_over_channels(context, fitted)
    for channel in range(len(context.channels)):
        covariance = fitted.fit.covariances[channel] if has_effects else np.zeros((0, 0))
        errors = SharedErrors(covariance) if is_shared else None
        own_root = errors.root if errors else _followed_root(covariance)
        with together(context.grid.group):
            for span, block, design in share.row_blocks(channel, fitted.estimate, added[channel], rows):
                model[channel, span] = root[channel, span] * block.vis
                power[channel, span] = noise[channel, span] * block.weights * np.abs(block.residual) ** 2
                felt = _felt(context, fitted, channel, block, design) if has_effects else None
                for t, row in enumerate(range(span.start, span.stop)):
                    weights, spread, columns = block.weights[t], np.zeros(len(block.bls)), None
                    if felt is not None:
                        columns, own = next(felt)
                        spread = _variances(columns, block.member, own, own_root).sum(axis=0)
                        if errors is None:
                            weights = weights / (1 + weights * spread)
                    by_beam = share.model_root(channel, row, fitted.estimate, design[t])
                    time = TimeWhitener.of(weights, block.member, by_beam)
                    z[channel, row] = time.rows(block.residual[t][:, np.newaxis])[:, 0]
                    share_of_model[channel, row] = time.share
                    uncertain[channel, row] = noise[channel, row] * block.weights[t] * (time.variance + spread)
                    if errors is not None and columns is not None:
                        errors.add(time, z[channel, row], columns)
        if errors is not None:
            errors_of.append(errors.complete(context.grid.group))
        if errors_of and not shared.any():
            # Columns of a channel are let go before those of the next one.
            span = slice(channel, channel + 1)
            _add_shared(context, errors_of, shared, rows.inv_noise_var[span] > 0, z[span], share_of_model[span])
            errors_of = []
    if errors_of:
        _add_shared(context, errors_of, shared, rows.inv_noise_var > 0, z, share_of_model)
    return Whitened(z, rows.inv_noise_var > 0, share_of_model, model, root, power, noise, uncertain)


def _add_shared(
    context: FitContext,
    errors_of: Sequence[SharedErrors],
    shared: BoolArray,
    used: BoolArray,
    z: ComplexArray,
    share_of_model: FloatArray,
) -> None:
    """Whiten rows by the errors of the effects, in place: those of all channels where these share some.

    Collective: all ranks that have rows of these channels.
    """
    grid = context.grid
    comm = grid.world if shared.any() else grid.group
    coefficients, felt = whitening_coefficients(errors_of, shared, comm, grid.is_group_root)
    for channel, errors in enumerate(errors_of):
        for row, change in enumerate(errors.changes(coefficients[channel])):
            z[channel, row] += change
        n_used = int(grid.group.allreduce(np.count_nonzero(used[channel])))
        share_of_model[channel] += felt[channel] / (2 * max(n_used, 1))


def _is_over_channels(context: FitContext, fitted: Fitted) -> bool:
    """Whether rows are whitened by what those of all channels share of the effects' errors."""
    n_channels = context.setup.observation.Nfreqs
    return n_channels > 1 and bool(fitted.values.shared.any()) and _is_shared(context, fitted, n_channels)


def _is_shared(context: FitContext, fitted: Fitted, n_channels: int = 1) -> bool:
    """Whether rows are whitened by what those of so many channels share of the effects' errors."""
    rows, active = context.problem.test, fitted.values.active
    n_groups = len(np.unique(context.problem.redundant.group[rows.bls]))
    n_columns = sum((n_groups if one.effect.is_by_group else len(rows.bls)) * one.size for one in active)
    n_params = sum(one.size for one in active)
    return 0 < n_params <= MAX_FOLLOWED and COMPLEX * n_channels * len(rows.times) * n_columns <= SHARED_BYTES


def _felt(
    context: FitContext, fitted: Fitted, channel: int, block: RowBlock, design: Array
) -> Iterator[tuple[Felt, FloatArray]]:
    """Yield how predictions feel the parameters of the effects, time after time.

    Yields
    ------
    felt : Felt
        By each parameter, where the beam follows it. Of none with too many parameters.
    own : ndarray, (Nbls,)
        With too many what each by itself adds to a row's variance, mean of that of its real and its imaginary part.
    """
    fit, active, number = fitted.fit, fitted.values.active, context.channels[channel]
    covariance = fit.covariances[channel]
    for t, parts in enumerate(columns_by_time(block, active, number)):
        if len(covariance) > MAX_FOLLOWED:
            widths, sparse = np.diag(covariance), of_baselines(parts, block.member)
            none = np.zeros((len(block.bls), 0), dtype=complex)
            yield Felt(none, none, np.zeros(0, dtype=bool)), 0.5 * (abs(sparse).power(2) @ widths)
            continue
        is_of_groups = np.repeat([of for _, of in parts], [part.shape[1] for part, _ in parts])
        beam = design[t] @ fit.beam_response[channel]
        by_beam = beam if fit.posteriors[channel].is_complex else beam[0] + 1j * beam[1]
        own, of_groups = by_beam[:, ~is_of_groups][block.member], by_beam[:, is_of_groups]
        for felt, wanted in ((own, False), (of_groups, True)):
            chosen = [_dense(part) for part, of in parts if of is wanted]
            felt += np.concatenate(chosen, axis=-1) if chosen else 0
        yield Felt(own, of_groups, is_of_groups), np.zeros(len(block.bls))


def _dense(matrix: Any) -> ComplexArray:
    return np.asarray(matrix if isinstance(matrix, np.ndarray) else matrix.toarray())


def _followed_root(covariance: FloatArray) -> FloatArray:
    """Return the root of the covariance of parameters that beams follow; empty with too many."""
    return root_of(covariance) if len(covariance) <= MAX_FOLLOWED else np.zeros((0, 0))


def _variances(felt: Felt, member: IntArray, own: FloatArray, root: FloatArray) -> FloatArray:
    """Return the variance of rows' real and imaginary parts, (2, Nbls); rows are of the groups ``member``."""
    # Of real parts and imaginary ones by themselves, as a product with complex numbers takes twice as long.
    mine, common = felt.own, felt.of_groups
    parts = ((mine.real, common.real), (mine.imag, common.imag))
    of_own, of_groups = root[~felt.is_of_groups], root[felt.is_of_groups]
    return own + np.stack([np.sum((one @ of_own + (two @ of_groups)[member]) ** 2, axis=-1) for one, two in parts])


def variance_by_effects(
    context: FitContext, fitted: Fitted, rows: Rows, added: ComplexArray
) -> tuple[FloatArray, bool]:
    """Return what the effects' uncertainty adds to the variance of predictions of single held-out rows.

    Serial.

    Parameters
    ----------
    context : FitContext
    fitted : Fitted
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
    with_beam = len(fitted.values.shared) <= MAX_FOLLOWED
    for channel in range(len(context.channels) if fitted.values.active else 0):
        root = _followed_root(fitted.fit.covariances[channel])
        for span, block, design in context.test.row_blocks(channel, fitted.estimate, added[channel], rows):
            for t, (felt, own) in enumerate(_felt(context, fitted, channel, block, design), start=span.start):
                variance[channel, :, t] = _variances(felt, block.member, own, root)
    return variance, with_beam
