"""The evidence for changes of the weights, from the sizes of the whitened residuals of the fitted rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray
from hydrabeam_mpi.effects.interface.reweighting import Reweighting, ReweightingFit
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import BrokenOff, refit
from hydrabeam_mpi.fit.heldout import whiten
from hydrabeam_mpi.fit.rows import Rows
from hydrabeam_mpi.fit.state import Fitted, Reweighted
from hydrabeam_mpi.fit.whitening import TimeWhitener
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.mpi import allreduce_sum, bcast_object, together

ROBUST_SIGMAS = 0.3
"""Of their errors, by which beams may still move in a fit that tells rows far out from others.

Weights that follow residuals take dozens of steps, each of which leaves three quarters of the way: then the beams are
off by their own errors, and rows by less than their noise.
"""


@dataclass(frozen=True)
class WeightsFound:
    """A change of the weights, its evidence, and the fit to whose residuals it was fitted."""

    change: Reweighting
    fit: ReweightingFit
    start: Fitted


class HeavyTails:
    """Weights for noise with Cauchy tails, under which outlying rows count less."""

    kind = "heavy_tails"
    leaves_out = False
    follows_residuals = True

    def weight_factor(self, block: RowBlock, x: FloatArray) -> FloatArray:
        """Return 3 / (1 + 2 |z|^2), as for a complex Student t distribution with one degree of freedom.

        The result is (Ntimes, Nbls).
        """
        return np.asarray(3 / (1 + 2 * np.abs(block.residual) ** 2 * block.weights))


def heavy_tails(context: FitContext) -> Reweighted:
    """Return weights by which rows far out count less, as part of a model."""
    none = np.zeros((context.setup.observation.Nfreqs, 0))
    return Reweighted(HeavyTails(), none, none)


def looked_for_again(context: FitContext, fitted: Fitted, found: Sequence[WeightsFound]) -> list[WeightsFound]:
    """Look for what was refused in the residuals of a fit in which outlying rows count less.

    A few strong outliers can pull a fit so far off that all rows seem to be outliers. There they are looked for beside
    residuals that are larger than noise, too, as they are where something else is missing. Returns all that was
    ``found``, those with what was found so. Collective: all ranks of the grid.
    """
    told = list(found)
    for i, one in enumerate(told):
        if one.change.searched_again_with_heavy_tails and one.fit.reason is not None:
            reweighted = fitted.values.reweighted
            values = replace(fitted.values, reweighted=(*reweighted, heavy_tails(context)))
            try:
                robust = refit(context, values, fitted, within=ROBUST_SIGMAS)
            except BrokenOff:
                continue
            again = _fit_once(context, _reweighted(robust, reweighted), one.change)
            if again.fit.reason is None:
                told[i] = again
    return told


def _fit_once(context: FitContext, fitted: Fitted, change: Reweighting) -> WeightsFound:
    """Fit a change of the weights, beside residuals that are larger than noise if it is refused beside noise."""
    (found,) = fit_reweightings(context, fitted, [change])
    if found.fit.reason is None or found.fit.levels is None:
        return found
    beside = change.at_levels(found.fit.levels)
    return fit_reweightings(context, fitted, [beside])[0] if beside is not None else found


def refit_reweighting(context: FitContext, fitted: Fitted, change: Reweighting) -> ReweightingFit:
    """Fit a change of the weights again, beside noise, to the residuals of a fit with these weights.

    What the beam has taken from each baseline is counted exactly, which is too long a sum for what is only weighed.
    Collective: all ranks of the grid.

    Parameters
    ----------
    context : FitContext
    fitted : Fitted
        With the weights that the change makes; these are taken from it again.
    change : Reweighting
    """
    observation = context.setup.observation
    effective = np.zeros((observation.Nfreqs, observation.Nbls))
    with together(context.grid.world):
        rows, added = context.train.calibrated(fitted.estimate)
        for channel, number in enumerate(context.channels):
            for _, block, design in context.train.row_blocks(channel, fitted.estimate, added[channel], rows):
                variance = _variance(fitted.fit.posteriors[channel], design)
                effective[number, block.bls] += 2 * np.sum(block.weights * variance[:, block.member], axis=0)
    allreduce_sum(context.grid.world, effective)
    others = tuple(one for one in fitted.values.reweighted if one.change is not change)
    return fit_reweightings(context, _reweighted(fitted, others), [change.beside_noise], effective, fitted)[0].fit


def _reweighted(fitted: Fitted, by: tuple[Reweighted, ...]) -> Fitted:
    """Return what has been fitted, with other weights."""
    return replace(fitted, values=replace(fitted.values, reweighted=by))


def _variance(posterior: Posterior, design: NDArray[Any]) -> FloatArray:
    """Return the beam's part of the variance of predictions, real and imaginary parts together, (Ntimes, Ngroups)."""
    n_modes = design.shape[-1]
    variance = posterior.predictive_variance(design.reshape(-1, n_modes)).reshape(design.shape[:-1])
    return variance if posterior.is_complex else variance.sum(axis=1)


def fit_reweightings(
    context: FitContext,
    fitted: Fitted,
    changes: Sequence[Reweighting],
    effective: FloatArray | None = None,
    weighted: Fitted | None = None,
) -> list[WeightsFound]:
    """Fit changes of the weights to the residuals of a fit.

    ``weighted`` has the weights with which it was made, where these are others. Collective: all ranks of the grid.
    """
    n_freqs = context.setup.observation.Nfreqs
    if effective is None:
        effective = np.zeros(n_freqs)
        if context.grid.is_group_root:
            effective[context.channels] = fitted.diagnostics.effective_parameters
        allreduce_sum(context.grid.world, effective)
    sums = [np.zeros((n_freqs, change.n_sums(context.setup))) for change in changes]
    weighs_heldout = any(change.weighs_heldout for change in changes)
    with together(context.grid.world):
        rows, added = context.train.calibrated(fitted.estimate)
        seen = context.train.calibrated(weighted.estimate)[0] if weighted is not None else rows
        for channel, number in enumerate(context.channels):
            for span, block, design in context.train.row_blocks(channel, fitted.estimate, added[channel], rows):
                z = block.residual * np.sqrt(block.weights)
                of_others = _beside_others(context, channel, span, block, design, fitted, seen) if weighs_heldout else z
                for change, total in zip(changes, sums, strict=True):
                    total[number] += change.sums(block, of_others if change.weighs_heldout else z)
    if weighs_heldout:
        _add_heldout(context, fitted, changes, sums)
    for total in sums:
        allreduce_sum(context.grid.world, total)
    fits = None
    with together(context.grid.world):
        if context.grid.is_world_root:
            fits = [change.fit(context.setup, total, effective) for change, total in zip(changes, sums, strict=True)]
    told: list[ReweightingFit] = bcast_object(context.grid.world, fits)
    return [WeightsFound(change, fit, fitted) for change, fit in zip(changes, told, strict=True)]


def _beside_others(
    context: FitContext, channel: int, span: slice, block: RowBlock, design: NDArray[Any], fitted: Fitted, seen: Rows
) -> ComplexArray:
    """Return a block's residuals over the errors of their prediction by all other times, (Ntimes, Nbls), E|z|^2 = 1.

    A beam that is told by few times follows one that is bad, and leaves of it what is left of a good one. ``seen`` are
    the rows with the weights of the fit, which has no part in times that have none.
    """
    z = np.zeros(block.shape, dtype=complex)
    for t, row in enumerate(range(span.start, span.stop)):
        by_beam = context.train.model_root(channel, row, fitted.estimate, design[t])
        in_fit = seen.inv_noise_var[channel, row] > 0
        for fitted_too in (True, False):
            weights = np.where(in_fit == fitted_too, block.weights[t], 0.0)
            if weights.any():
                time = TimeWhitener.of(weights, block.member, by_beam, fitted_too)
                z[t] += time.rows(block.residual[t][:, np.newaxis])[:, 0] / np.sqrt(2)
    return z


def _add_heldout(
    context: FitContext, fitted: Fitted, changes: Sequence[Reweighting], sums: Sequence[FloatArray]
) -> None:
    """Add this rank's held-out rows to the sums of changes for which they count. Collective: all ranks of the grid."""
    whitened = whiten(context, fitted)
    with together(context.grid.world):
        for channel, number in enumerate(context.channels):
            tile, z = context.test.rows.tile, np.where(whitened.used[channel], whitened.z[channel], 0.0) / np.sqrt(2)
            for change, total in zip(changes, sums, strict=True):
                total[number] += change.heldout_sums(context.setup, tile.times, tile.bls, z)
