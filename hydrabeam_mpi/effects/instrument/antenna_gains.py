"""Antenna gains that calibration left wrong: V_jk -> g_j g_k* V_jk with g = exp(a + i phi), constant in time."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from hydrabeam_mpi.data.observation import BoolArray, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.instrument.gain_laws import laws_followed
from hydrabeam_mpi.effects.instrument.gain_solution import solved_gains
from hydrabeam_mpi.effects.interface.effect import Columns, Effect, Parameters
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.shared.in_channels import InChannels
from hydrabeam_mpi.effects.shared.per_antenna import (
    antenna_parameters,
    common_values,
    logarithms,
    lost_signs,
    phases_without_turns,
    product_of_gains,
    row_antennas,
    row_parameters,
)


class AntennaGains(InChannels):
    """Amplitude and phase of each antenna's gain.

    With logarithms of gains as parameters the columns do not depend on them. What all amplitudes have in common scales
    the beam, and what all phases have in common cancels.

    Parameters
    ----------
    channels : {"each", "alike"}
        Whether each channel has gains of its own, or all have the same.
    """

    kind = "antenna_gains"
    title = "antenna gains"
    linear = True
    multiplies = True
    laws: ClassVar = {
        "smooth": "antenna gains that drift",
        "sidereal": "antenna gains that drift by sidereal time",
        "nightly": "antenna gains that drift anew each night",
        "piecewise": "antenna gains that jump",
        "correlated": "antenna gains that are correlated in time",
    }

    def parameters(self, setup: ObservingSetup) -> Parameters:
        """Return ln amplitude and phase of every antenna."""
        return antenna_parameters(setup, ("ln amplitude", "phase"), ("", "rad"), 1.0)

    def degenerate_directions(self, setup: ObservingSetup) -> FloatArray:
        """Return the amplitude and the phase that all antennas have in common, (n_directions, n_params)."""
        return common_values(len(setup.antennas_in_use), 2)

    def undecidable_in_time(self, setup: ObservingSetup) -> FloatArray:
        """Return the phase that all antennas have in common: an amplitude is told from a beam that does not change."""
        return self.degenerate_directions(setup)[1:]

    def common_in_time(self, setup: ObservingSetup) -> tuple[tuple[str, ...], FloatArray]:
        """Return the amplitude, as all receivers have the weather in common."""
        return ("all antennas ln amplitude",), np.tile([[1.0, 0.0]], len(setup.antennas_in_use))

    def columns(self, block: RowBlock, x: FloatArray) -> Columns:
        """Return m, i m for the first antenna of a row and m, -i m for the second; ``x`` is (n_params,)."""
        values = block.vis[..., np.newaxis] * np.array([1, 1j, 1, -1j])
        return Columns(values, 2 * len(block.setup.antennas_in_use), row_parameters(block, 2))

    def begun(self, setup: ObservingSetup, x: FloatArray) -> FloatArray:
        """Return the logarithms of the gains that were found, (..., n_params)."""
        return logarithms(x)

    def needed_at(self, setup: ObservingSetup, x: FloatArray) -> tuple[Effect, IntArray, BoolArray]:
        """Return the effect, and the phases of lost signs."""
        return self, np.arange(x.shape[-1]), lost_signs(x)

    def beside_model(
        self, setup: ObservingSetup, overlap: ComplexArray, model: FloatArray
    ) -> tuple[FloatArray, ComplexArray] | None:
        """Return the gains of calibration, of each channel, (Nfreqs, n_params), and the product of both antennas'."""
        if self.shared:
            return None
        ends, n = np.searchsorted(setup.antennas_in_use, setup.antenna_index), len(setup.antennas_in_use)
        gains = np.array([solved_gains(*one, ends, n) for one in zip(overlap, model, strict=True)])
        x = np.stack([gains.real - 1, gains.imag], axis=-1).reshape(len(gains), -1)
        return x, gains[:, ends[:, 0]] * gains[:, ends[:, 1]].conj()

    def without_turns(self, setup: ObservingSetup, x: FloatArray) -> FloatArray:
        """Return the parameters with phases from -pi to pi, (..., n_params)."""
        return phases_without_turns(x)

    def simpler_elements(
        self, setup: ObservingSetup, x: FloatArray, std: FloatArray
    ) -> list[tuple[BoolArray, Effect, FloatArray]]:
        """Return antennas whose gains of all channels may be the same, from a delay each, or from an echo each."""
        alike = self.same_in_all_channels()
        return [] if alike is None else laws_followed(setup, x, std, alike)

    def factor(self, block: RowBlock, x: FloatArray) -> ComplexArray:
        """Return g_j g_k*, (Ntimes, Nbls)."""
        return np.broadcast_to(product_of_gains(*(x[0::2] + 1j * x[1::2])[row_antennas(block)].T), block.shape)

    def gains(self, setup: ObservingSetup, channel: int, x: FloatArray) -> ComplexArray:
        """Return exp(a + i phi), (Nants,)."""
        gains = np.ones(setup.observation.Nants, dtype=complex)
        gains[setup.antennas_in_use] = np.exp(x[0::2] + 1j * x[1::2])
        return gains
