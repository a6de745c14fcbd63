"""Gains of antennas, given in files and found as effects: what a summary says of them.

Data have been divided by the gains that files give before anything was fitted, and what effects find multiplies these:
V = g_i g_j* ..., with g = given times found.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hydrabeam_mpi.data.degenerate_gains import phase_directions
from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.fit.state import Values
from hydrabeam_mpi.fit.taken_out import antenna_gains
from hydrabeam_mpi.io.checksums import checksum
from hydrabeam_mpi.io.gains import mean_gains
from hydrabeam_mpi.io.posterior_file import ChannelRecord
from hydrabeam_mpi.setup.problem import Problem

STEP = 1e-3
"""Part of its prior by which a parameter is moved to see how the gains follow: far above rounding, and gains are
exponentials of it or nearly so."""


def gains_told(
    problem: Problem,
    records: Sequence[ChannelRecord],
    setup: ObservingSetup | None = None,
    values: Values | None = None,
) -> dict[str, Any]:
    """Return ``gains`` of a summary, nothing where none were given nor found. Serial.

    Parameters
    ----------
    problem : Problem
        Of all channels.
    records : sequence of ChannelRecord
    setup : ObservingSetup, optional
    values : Values, optional
        The effects that were fitted.
    """
    has_gains = values is not None and any(one.effect.multiplies and one.effect.has_gains for one in values.active)
    if not (problem.gain_files or has_gains):
        return {}
    observation = problem.observation
    channels: list[dict[str, Any]] = [{"freq_hz": float(freq)} for freq in observation.freqs]
    if problem.gain_files:
        gains = mean_gains(problem.gain_files, observation)
        given = np.log(np.abs(gains)), np.angle(gains)
        for channel, ln_amplitude, phase in zip(channels, *given, strict=True):
            channel["given"] = {"ln_amplitude": _listed(ln_amplitude), "phase": _listed(phase)}
    if has_gains and setup is not None and values is not None:
        gains = antenna_gains(setup, values)
        found = np.log(np.abs(gains)).mean(axis=1), np.angle((gains / np.abs(gains)).mean(axis=1))
        for number, (channel, record) in enumerate(zip(channels, records, strict=True)):
            spread = _spread(setup, values, number, record.arrays["effects_covariance"])
            names = ("ln_amplitude", "phase", "ln_amplitude_std", "phase_std")
            numbers = (found[0][number], found[1][number], *spread)
            channel["found"] = {name: _listed(part) for name, part in zip(names, numbers, strict=True)}
    about = {
        "files": [{"file": str(path), "sha256": checksum(path)} for path in problem.gain_files],
        "meaning": "V = g_i g_j* ..., g = given times found; data were divided by the given gains before the fit",
        "antennas": observation.antenna_numbers.tolist(),
        "east_north_m": observation.antpos[:, :2].tolist(),
        "feed": observation.pols[0][0],
        "times_jd": observation.times.tolist(),
        "integration_time_s": observation.integration_time.tolist(),
        "pol_convention": observation.convention,
        "channels": channels,
    }
    return {"gains": about}


def _listed(values: FloatArray) -> list[float | None]:
    """Return numbers, None where there are none."""
    return [float(value) if np.isfinite(value) else None for value in values]


def _spread(
    setup: ObservingSetup, values: Values, channel: int, covariance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the errors of ln amplitudes and phases in a channel, (Nants,) each, less their degenerate directions."""
    slopes = []
    for one in values.active:
        has_gains = one.effect.multiplies and one.effect.has_gains
        steps = STEP * one.prior.of(channel).std()
        at = one.effect.gains(setup, channel, one.x[channel]) if has_gains else None
        for parameter, step in zip(one.used.tolist(), steps.tolist(), strict=True):
            x = one.x[channel].copy()
            x[parameter] += step
            ratio = np.ones((1, setup.observation.Nants)) if at is None else one.effect.gains(setup, channel, x) / at
            slopes.append(np.log(np.atleast_2d(ratio).astype(complex)).mean(axis=0) / step)
    plane = phase_directions(setup.observation.antpos[:, :2])

    def error(slope: FloatArray, directions: FloatArray) -> FloatArray:
        left = slope - directions @ (np.linalg.pinv(directions) @ slope)
        return np.sqrt(np.einsum("aq,qr,ar->a", left, covariance, left).clip(min=0))

    slope = np.array(slopes).T
    return error(slope.real, plane[:, :1]), error(slope.imag, plane)
