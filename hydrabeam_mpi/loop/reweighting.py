"""The evidence for changes of the weights, from the sizes of the whitened residuals of the fitted rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.outliers import Outliers
from hydrabeam_mpi.effects.reweighting import Reweighting, ReweightingFit
from hydrabeam_mpi.effects.scene import Scene
from hydrabeam_mpi.loop.refit import Space, refit
from hydrabeam_mpi.loop.state import Reweighted, State
from hydrabeam_mpi.mpi import allreduce_sum, bcast_object, together


@dataclass(frozen=True)
class WeightsFound:
    """A change of the weights, its evidence, and the state whose residuals have told it."""

    change: Reweighting
    fit: ReweightingFit
    start: State


class HeavyTails:
    """Weights of noise with the tails of a Cauchy distribution: rows count the less the further off they are."""

    kind = "heavy_tails"

    def weight_factor(self, scene: Scene, x: FloatArray) -> FloatArray:
        """Return 3 / (1 + 2 |z|^2), as for a complex Student t distribution with one degree of freedom."""
        return np.asarray(3 / (1 + 2 * np.abs(scene.residual) ** 2 * scene.weights))


def fit_reweightings(space: Space, state: State, changes: Sequence[Reweighting]) -> list[WeightsFound]:
    """Fit every change of the weights. Collective: all ranks of the grid.

    A few strong outliers pull a fit so far off that all rows seem to be outliers. Where these are refused they are
    therefore looked for once more, in the residuals of a fit to which rows count the less the further off they are.
    """
    found = _fit_all(space, state, changes)
    for i, one in enumerate(found):
        if isinstance(one.change, Outliers) and one.fit.reason is not None:
            n_freqs = space.experiment.observation.Nfreqs
            tails = Reweighted(HeavyTails(), np.zeros((n_freqs, 0)), np.zeros((n_freqs, 0)))
            robust = refit(space, replace(state, reweighted=[*state.reweighted, tails]))
            again = _fit_all(space, replace(robust, reweighted=state.reweighted), [one.change])[0]
            if again.fit.reason is None:
                found[i] = again
    return found


def _fit_all(space: Space, state: State, changes: Sequence[Reweighting]) -> list[WeightsFound]:
    """Fit changes of the weights to the residuals of a state. Collective: all ranks of the grid."""
    n_freqs = space.experiment.observation.Nfreqs
    effective = np.zeros(n_freqs)
    if space.grid.is_group_root:
        effective[space.channels] = state.effective_parameters
    allreduce_sum(space.grid.world, effective)
    sums = [np.zeros((n_freqs, change.n_sums(space.experiment))) for change in changes]
    with together(space.grid.world):
        rows, added = space.train.calibrated(state)
        for channel, number in enumerate(space.channels):
            for _, scene, _ in space.train.scenes(channel, state, added[channel], rows):
                z = scene.residual * np.sqrt(scene.weights)
                for change, total in zip(changes, sums, strict=True):
                    total[number] += change.sums(scene, z)
    for total in sums:
        allreduce_sum(space.grid.world, total)
    fits = None
    with together(space.grid.world):
        if space.grid.is_world_root:
            fits = [change.fit(space.experiment, total, effective) for change, total in zip(changes, sums, strict=True)]
    told: list[ReweightingFit] = bcast_object(space.grid.world, fits)
    return [WeightsFound(change, fit, state) for change, fit in zip(changes, told, strict=True)]
