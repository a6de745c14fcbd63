"""Draws from a result whose beams hang together over frequency: of all channels together, as many as are wanted."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import Any

import numpy as np

from hydrabeam_mpi.config.frequency import OverFrequency
from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.inference.coupled import ChannelTold, CoupledEquations, choose_length
from hydrabeam_mpi.setup.over_frequency import couple


def check_drawn_again(summary: dict[str, Any]) -> None:
    """Make sure that a result has what it takes to make further draws.

    Raises
    ------
    InputError
        If it was not found by one matrix, which then is too large, or has effects.
    """
    how = None
    if summary["solver"] != "dense":
        how = "that were solved for by conjugate gradients"
    elif summary.get("with_effects"):
        how = "that hang together over frequency, with effects"
    if how:
        raise InputError(
            f"no more draws can be made of beams {how}",
            field="[output] draws",
            remedy="use those in posterior.h5, or infer again with more",
        )


def draw_again(
    summary: dict[str, Any],
    freqs: FloatArray,
    parts: Iterable[tuple[Array, Array]],
    widths: FloatArray,
    seed: int,
    n_draws: int,
) -> Array:
    """Draw coefficients, in units of the prior's widths about its mean, of all channels together.

    By one matrix, as the result was; see `check_drawn_again`. Serial.

    Parameters
    ----------
    summary : dict
        What was told of all channels together.
    freqs : ndarray, (Nchan,)
        Hz.
    parts : iterable of (ndarray, ndarray)
        Information and score of each channel's coefficients, (n, n) and (n,).
    widths : ndarray, (Nchan, n)
    seed : int
    n_draws : int

    Returns
    -------
    ndarray, (n_draws, Nchan, n)
    """
    coupling = couple(OverFrequency.model_validate_json(json.dumps(summary["settings"])), freqs)
    assert coupling is not None
    told = [ChannelTold.of(*one, width) for one, width in zip(parts, widths, strict=True)]
    keys = [[("posterior draw", channel, draw) for draw in range(n_draws)] for channel in range(len(told))]
    noise = [one.noise(key, seed, len(told)) for one, key in zip(told, keys, strict=True)]
    weights = np.array(summary.get("weights", [1.0]))
    chosen, drawn = choose_length(weights, seed, n_draws), np.zeros((n_draws, *widths.shape), told[0].score.dtype)
    for number in np.unique(chosen):
        equations = CoupledEquations(coupling.candidates[number], widths.shape[1], np.iscomplexobj(drawn), n_draws)
        for channel, one in enumerate(told):
            equations.add(channel, one, noise[channel])
        drawn[chosen == number] = equations.solve().draws(seed, np.flatnonzero(chosen == number).tolist())
    return drawn
