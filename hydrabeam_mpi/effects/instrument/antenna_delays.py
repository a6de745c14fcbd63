"""Delays that calibration left in the antennas' signals: V_jk -> g_j g_k* V_jk with g = exp(2 pi i nu tau)."""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray
from hydrabeam_mpi.effects.interface.effect import Columns, Effect, Parameters
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.shared.per_antenna import antenna_parameters, common_values, row_antennas

NS = 1e-9  # seconds in the unit of the parameters


class AntennaDelays(Effect):
    """One delay an antenna, the same at all channels: a cable longer than thought, or a clock that is behind.

    As V_jk turns as exp(+2 pi i nu b.s / c), a signal that comes late has its phase turned forward: tau > 0 is late.
    The phase is that of the observed frequency itself, not of its distance from the band's centre, because a delay acts
    on the sky's own frequency; what a calibration of phases has taken out of it is left to the antenna gains. A delay
    that all antennas share cancels.
    """

    kind = "antenna_delays"
    title = "antenna delays"
    multiplies = True
    shared = True

    def not_applicable(self, setup: ObservingSetup) -> str | None:
        """Ask for several channels."""
        if len(np.unique(setup.observation.freqs)) < 2:
            return "a delay needs several channels; with one it is a gain phase"
        return None

    def parameters(self, setup: ObservingSetup) -> Parameters:
        """Return the delay of every antenna in ns."""
        return antenna_parameters(setup, ["delay"], "ns", 1.0)

    def degenerate_directions(self, setup: ObservingSetup) -> FloatArray:
        """Return the delay that all antennas have in common, (n_directions, n_params)."""
        return common_values(len(setup.antennas_in_use), 1)

    def columns(self, block: RowBlock, x: FloatArray) -> Columns:
        """Return 2 pi i nu m for the first antenna of a row and its negative for the second; ``x`` is (n_params,)."""
        turn = 2j * np.pi * block.freq * NS
        values = block.vis[..., np.newaxis] * np.array([turn, -turn])
        return Columns(values, len(block.setup.antennas_in_use), row_antennas(block))

    def factor(self, block: RowBlock, x: FloatArray) -> ComplexArray:
        """Return exp(2 pi i nu (tau_j - tau_k)), (Ntimes, Nbls)."""
        first, second = x[row_antennas(block)].T
        rows = np.exp(2j * np.pi * block.freq * NS * (first - second))
        return np.broadcast_to(rows, block.shape)

    def gains(self, setup: ObservingSetup, channel: int, x: FloatArray) -> ComplexArray:
        """Return exp(2 pi i nu tau), (Nants,)."""
        gains = np.ones(setup.observation.Nants, dtype=complex)
        gains[setup.antennas_in_use] = np.exp(2j * np.pi * setup.observation.freqs[channel] * NS * x)
        return gains
