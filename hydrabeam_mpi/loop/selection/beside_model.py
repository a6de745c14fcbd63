"""What data say beside the model beam, which is not fitted: gains of antennas, as calibration finds them.

Gains that are far from one leave a beam that is fitted without them with nothing to follow, and about such a beam no
linear model says what is wrong. Calibration does, which needs to know no more of the beam than that it is nearly right.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.error_scale import left_of
from hydrabeam_mpi.fit.state import Fitted
from hydrabeam_mpi.loop.attribution.evidence import Evidence
from hydrabeam_mpi.loop.attribution.score_effects import Finding
from hydrabeam_mpi.loop.selection.acceptance import Candidate
from hydrabeam_mpi.mpi import allreduce_sum, together


def told_by_model(context: FitContext, fitted: Fitted, effects: Sequence[Effect]) -> Candidate | None:
    """Return the effect with which the model beam leaves less of the fitted data than the fitted beam does without.

    None where each leaves more, as in all data that are nearly calibrated, or where more than the beam is in the model
    already. Collective: all ranks of the grid.
    """
    known = [one.effect for one in fitted.values.active if not one.effect.is_about_the_beam]
    if fitted.values.reweighted or any(effect.is_sought for effect in known):
        return None
    overlap, model, data = _products(context)
    candidates, left_now = list[Candidate](), left_of(context, fitted).chi2
    for effect in effects:
        if (told := effect.beside_model(context.setup, overlap, model)) is None:
            continue
        x, factor = told
        gained = left_now - float(np.sum(data - 2 * (factor.conj() * overlap).real + np.abs(factor) ** 2 * model))
        if gained > 0:
            candidates.append(Candidate.of(Finding(effect, _evidence(context, effect, x, gained))))
    return max(candidates, key=lambda one: one.log_bayes_factor, default=None)


def _evidence(context: FitContext, effect: Effect, x: FloatArray, gained: float) -> Evidence:
    """Return what columns at zero would have found, (Nfreqs, n_params), with priors as wide as each sort scatters."""
    begun = effect.begun(context.setup, x)
    sort = effect.parameters(context.setup).sort
    sort = np.zeros(x.shape[1], dtype=int) if sort is None else sort
    prior_var = np.array([np.mean(begun[:, sort == one] ** 2) for one in sort])
    return Evidence(gained, prior_var, x, 2 * gained, float(x.size), 0.0, x.size, gained)


def _products(context: FitContext) -> tuple[ComplexArray, FloatArray, FloatArray]:
    """Return sums over the fitted times of w d m*, w |m|^2 and w |d|^2, (Nfreqs, Nbls). Collective: all ranks."""
    observation, rows = context.setup.observation, context.train.rows
    sums = np.zeros((3, observation.Nfreqs, observation.Nbls), dtype=complex)
    with together(context.grid.world):
        weights, model = rows.inv_noise_var, context.train.model_beam[:, :, rows.member]
        parts = weights * rows.data * model.conj(), weights * np.abs(model) ** 2, weights * np.abs(rows.data) ** 2
        for total, part in zip(sums, parts, strict=True):
            total[np.array(context.channels)[:, np.newaxis], rows.tile.bls] += part.sum(axis=1)
    allreduce_sum(context.grid.world, sums)
    return sums[0], sums[1].real, sums[2].real
