"""What is told of the parameters that a round has found: values and errors."""

from __future__ import annotations

from typing import Any

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.parameters import Parameters
from hydrabeam_mpi.effects.interface.told import Told
from hydrabeam_mpi.fit.error_scale import ErrorScale
from hydrabeam_mpi.fit.state import Active, Fitted
from hydrabeam_mpi.loop.selection.acceptance import Round

LEAST_TOLD = 0.5
"""A parameter counts as measured if its posterior variance is at most this fraction of the prior's."""


def widened(one: Round, scale: ErrorScale) -> list[float]:
    """Return by how much the errors of a round's parameters are larger than the noise alone makes them, by channel."""
    if one.candidate.finding is None:
        return [1.0] * len(scale.channels)
    return [scale.together] if one.candidate.finding.effect.shared else scale.channels.tolist()


def parameters_of(
    setup: ObservingSetup, one: Round, last: Fitted, scale: ErrorScale
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return the parameters in use with their standard deviations, channel by channel where they differ.

    These are larger than those by the noise alone by ``scale``. They are of the last fit, in which all effects are
    fitted jointly. Those whose variance is more than half of the prior's come apart: they are no measurements, as what
    is said of them depends on the prior. Where all are such, all are returned as parameters.
    """
    if one.candidate.weights is not None:
        weights, shared = one.candidate.weights, False
        fit, used = weights.fit, np.flatnonzero(weights.change.is_told(weights.fit.x))
        told = Told(fit.names, fit.units, fit.x, fit.std, np.zeros(len(fit.names), dtype=bool))
        is_told = np.array([weights.change.is_told(x[np.newaxis])[used] for x in fit.x])
    else:
        active, std = _at_last(one, last)
        std = scale.of(active, std)
        told, used, shared = active.effect.told(setup, active.x, std), active.used, active.effect.shared
        prior_std = np.array([active.prior.of(f).std() for f in range(len(std))])
        is_told = std[:, used] ** 2 <= LEAST_TOLD * prior_std**2
    parameters: list[dict[str, Any]] = []
    not_told: list[dict[str, Any]] = []
    for f, freq in enumerate([None] if shared else setup.observation.freqs.tolist()):
        for i, known in zip(used.tolist(), is_told[f], strict=True):
            value, error = float(told.values[f, i]), float(told.std[f, i])
            sigma = abs(value) / error if told.from_zero[i] and error else None
            entry = {"name": told.names[i], "unit": told.units[i], "value": value, "std": error, "sigma": sigma}
            (parameters if known else not_told).append({**entry, "freq_hz": freq})
    if one.candidate.weights is not None:
        # What is as stated in a channel is nothing to tell of it.
        return parameters, []
    return (parameters, not_told) if parameters else (not_told, [])


def counted(one: Round, last: Fitted) -> dict[str, float]:
    """Return how many parameters a round's effect has in the last fit, and how many of them the data decide.

    Later rounds may have left out some of those that it had when it was found.
    """
    active, std = _at_last(one, last)
    decided = 1 - np.minimum(std[:, active.used] / [active.prior.of(f).std() for f in range(len(std))], 1.0) ** 2
    n_blocks = 1 if active.effect.shared else len(std)
    return {"n_parameters": active.size * n_blocks, "effective_parameters": float(decided[:n_blocks].sum())}


def prior_scale_of(setup: ObservingSetup, one: Round, last: Fitted) -> float | None:
    """Return the width of the prior of a round's effect in the last fit, as `prior_scale` does."""
    active, _ = _at_last(one, last)
    return prior_scale(active.effect.parameters(setup), active.prior_var(setup))


def prior_scale(parameters: Parameters, prior_var: FloatArray) -> float | None:
    """Return the width of a prior of variances, (n_params,), in natural sizes, where it is one for all in use."""
    used = prior_var > 0
    widths = np.sqrt(prior_var[used]) / parameters.scale[used]
    return float(widths[0]) if widths.size and np.allclose(widths, widths[0]) else None


def _at_last(one: Round, last: Fitted) -> tuple[Active, FloatArray]:
    """Return a round's effect in the last fit and its standard deviations; as it was found if it was taken back."""
    fitted, number = (one.after.fitted, -1) if one.place is None else (last, one.place)
    return one.taken_back or (fitted.values.active[number], fitted.fit.std[number])
