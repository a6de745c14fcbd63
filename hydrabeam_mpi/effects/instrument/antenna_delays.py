"""Delays that calibration left in the antennas' signals: V_jk -> g_j g_k* V_jk g = exp(i (2 pi nu tau + phi))."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray
from hydrabeam_mpi.effects.interface.effect import Columns, Effect, Parameters
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.shared.per_antenna import antenna_parameters, common_values, row_antennas, row_parameters

NS = 1e-9  # seconds in the unit of the parameters


class AntennaDelays(Effect):
    """One delay and one phase an antenna, the same at all channels: a cable longer than thought, or a clock behind.

    Both may change in time, as cables do that get warm.
    As V_jk turns as exp(+2 pi i nu b.s / c), a signal that comes late has its phase turned forward: tau > 0 is late.
    A delay acts on the sky's own frequency, and alone turns the phase by 2 pi nu tau; after a mixer, or where a
    calibration has set the phase right somewhere in the band, there is a constant phi besides. The parameter is the
    phase at the mean frequency nu_0 of the channels, 2 pi nu_0 tau + phi, which hardly depends on the delay. What all
    antennas have in common of either cancels.
    """

    kind = "antenna_delays"
    title = "antenna delays and phases"
    multiplies = True
    shared = True
    laws: ClassVar = {
        "smooth": "antenna delays and phases that drift",
        "piecewise": "antenna delays and phases that jump",
    }

    def not_applicable(self, setup: ObservingSetup) -> str | None:
        """Ask for several channels."""
        if len(np.unique(setup.observation.freqs)) < 2:
            return "a delay needs several channels; with one it is a gain phase"
        return None

    def parameters(self, setup: ObservingSetup) -> Parameters:
        """Return delay and phase of every antenna."""
        return antenna_parameters(setup, ("delay", "phase"), ("ns", "rad"), 1.0)

    def degenerate_directions(self, setup: ObservingSetup) -> FloatArray:
        """Return the delay and the phase that all antennas have in common, (n_directions, n_params)."""
        return common_values(len(setup.antennas_in_use), 2)

    def columns(self, block: RowBlock, x: FloatArray) -> Columns:
        """Return m d ln g for a row's first antenna, and -m d ln g for its second; ``x`` is (n_params,)."""
        turns = 1j * _slopes(block.setup, block.channel)
        values = block.vis[..., np.newaxis] * np.concatenate([turns, -turns])
        return Columns(values, 2 * len(block.setup.antennas_in_use), row_parameters(block, 2))

    def factor(self, block: RowBlock, x: FloatArray) -> ComplexArray:
        """Return g_j g_k*, (Ntimes, Nbls)."""
        first, second = phases_of(block.setup, block.channel, x)[row_antennas(block)].T
        return np.broadcast_to(np.exp(1j * (first - second)), block.shape)

    def gains(self, setup: ObservingSetup, channel: int, x: FloatArray) -> ComplexArray:
        """Return exp(i (2 pi nu tau + phi)), (Nants,)."""
        gains = np.ones(setup.observation.Nants, dtype=complex)
        gains[setup.antennas_in_use] = np.exp(1j * phases_of(setup, channel, x))
        return gains


def _slopes(setup: ObservingSetup, channel: int) -> FloatArray:
    """Return by how much a phase rises with a delay in ns and with the phase at the mean frequency, (2,)."""
    offset = float(setup.observation.freqs[channel]) - setup.reference_freq
    return np.array([2 * np.pi * offset * NS, 1.0])


def phases_of(setup: ObservingSetup, channel: int, x: FloatArray) -> FloatArray:
    """Return the phase of every antenna in a channel, (Nused,)."""
    return x.reshape(-1, 2) @ _slopes(setup, channel)


def delays_of(setup: ObservingSetup, phases: FloatArray) -> FloatArray:
    """Return delay and phase of each antenna that come nearest to its phases in all channels, whole turns apart.

    Parameters
    ----------
    setup : ObservingSetup
    phases : ndarray, (Nfreqs, Nants)
        Radians.

    Returns
    -------
    ndarray, (2 Nants,)
        In ns and radians, as the parameters of `AntennaDelays`. Of delays that channels cannot tell apart the smallest.
    """
    offsets = setup.observation.freqs - setup.reference_freq
    span, spacing = np.ptp(offsets), np.diff(np.unique(offsets)).min()
    # Steps of an eighth of what the band resolves: from one to the next the phases at its ends change by 0.4 rad.
    n = int(np.ceil(4 * span / spacing))
    delays = np.arange(-n, n + 1) / (8 * span)
    turned = np.exp(-2j * np.pi * np.outer(delays, offsets)) @ np.exp(1j * phases)
    best = np.argmax(np.abs(turned) * (1 - 1e-9 * np.abs(np.arange(-n, n + 1)))[:, np.newaxis], axis=0)
    at_center = np.angle(turned[best, np.arange(phases.shape[1])])
    left = np.angle(np.exp(1j * (phases - at_center - 2 * np.pi * np.outer(offsets, delays[best]))))
    slopes, mean = np.polynomial.polynomial.polyfit(offsets / span, left, 1)[::-1]
    return np.stack([(delays[best] + slopes / (2 * np.pi * span)) / NS, at_center + mean], axis=-1).ravel()
