"""The evidence for changes of the weights, from the sizes of the whitened residuals of the fitted rows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydrabeam_mpi.effects.reweighting import Reweighting, ReweightingFit
from hydrabeam_mpi.loop.refit import Space
from hydrabeam_mpi.loop.state import State
from hydrabeam_mpi.mpi import allreduce_sum, bcast_object, together


def fit_reweightings(
    space: Space, state: State, changes: Sequence[Reweighting]
) -> list[tuple[Reweighting, ReweightingFit]]:
    """Fit every change of the weights. Collective: all ranks of the grid."""
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
            fits = [
                (change, change.fit(space.experiment, total, effective))
                for change, total in zip(changes, sums, strict=True)
            ]
    result: list[tuple[Reweighting, ReweightingFit]] = bcast_object(space.grid.world, fits)
    return result
