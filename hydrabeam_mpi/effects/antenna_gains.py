"""Antenna gains that calibration left wrong: V_jk -> g_j g_k* V_jk with g = exp(a + i phi), constant in time."""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray
from hydrabeam_mpi.effects.base import Columns, Effect, Parameters
from hydrabeam_mpi.effects.experiment import Experiment
from hydrabeam_mpi.effects.per_antenna import common_values
from hydrabeam_mpi.effects.scene import Scene


class AntennaGains(Effect):
    """Amplitude and phase of each antenna's gain, each channel its own.

    With logarithms of gains as parameters the columns do not depend on them. What all amplitudes have in common scales
    the beam, and what all phases have in common cancels.
    """

    kind = "antenna_gains"
    title = "antenna gains"
    linear = True
    multiplies = True

    def parameters(self, experiment: Experiment) -> Parameters:
        """Return ln amplitude and phase of every antenna."""
        antennas = experiment.antennas_in_use
        numbers = experiment.observation.antenna_numbers[antennas]
        names = [f"antenna {number} {what}" for number in numbers for what in ("ln amplitude", "phase")]
        return Parameters.of(names, ["", "rad"] * len(antennas), 1.0, np.repeat(np.arange(len(antennas)), 2))

    def undecidable(self, experiment: Experiment) -> FloatArray:
        """Return the amplitude and the phase that all antennas have in common."""
        return common_values(len(experiment.antennas_in_use), 2)

    def columns(self, scene: Scene, x: FloatArray) -> Columns:
        """Return m, i m for the first antenna of a row and m, -i m for the second."""
        first, second = (np.searchsorted(scene.experiment.antennas_in_use, ant) for ant in (scene.ant1, scene.ant2))
        index = np.stack([2 * first, 2 * first + 1, 2 * second, 2 * second + 1], axis=-1)
        values = scene.vis[..., np.newaxis] * np.array([1, 1j, 1, -1j])
        return Columns(values, 2 * len(scene.experiment.antennas_in_use), index)

    def factor(self, scene: Scene, x: FloatArray) -> ComplexArray:
        """Return g_j g_k*."""
        gains = np.zeros(len(scene.experiment.observation.antenna_numbers), dtype=complex)
        gains[scene.experiment.antennas_in_use] = x[0::2] + 1j * x[1::2]
        rows = np.exp(gains[scene.ant1] + gains[scene.ant2].conj())
        return np.broadcast_to(rows, scene.shape)
