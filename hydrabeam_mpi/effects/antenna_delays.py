"""Delays that calibration left in the antennas' signals: V_jk -> g_j g_k* V_jk with g = exp(2 pi i nu tau)."""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray
from hydrabeam_mpi.effects.base import Columns, Effect, Parameters
from hydrabeam_mpi.effects.experiment import Experiment
from hydrabeam_mpi.effects.per_antenna import antenna_parameters, common_values, row_antennas
from hydrabeam_mpi.effects.scene import Scene

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

    def refusal(self, experiment: Experiment) -> str | None:
        """Ask for several channels."""
        if len(np.unique(experiment.observation.freqs)) < 2:
            return "a delay needs several channels; with one it is a gain phase"
        return None

    def parameters(self, experiment: Experiment) -> Parameters:
        """Return the delay of every antenna in ns."""
        return antenna_parameters(experiment, ["delay"], "ns", 1.0)

    def undecidable(self, experiment: Experiment) -> FloatArray:
        """Return the delay that all antennas have in common."""
        return common_values(len(experiment.antennas_in_use), 1)

    def columns(self, scene: Scene, x: FloatArray) -> Columns:
        """Return 2 pi i nu m for the first antenna of a row and its negative for the second."""
        turn = 2j * np.pi * scene.freq * NS
        values = scene.vis[..., np.newaxis] * np.array([turn, -turn])
        return Columns(values, len(scene.experiment.antennas_in_use), row_antennas(scene))

    def factor(self, scene: Scene, x: FloatArray) -> ComplexArray:
        """Return exp(2 pi i nu (tau_j - tau_k))."""
        delays = np.zeros(len(scene.experiment.observation.antenna_numbers))
        delays[scene.experiment.antennas_in_use] = x
        rows = np.exp(2j * np.pi * scene.freq * NS * (delays[scene.ant1] - delays[scene.ant2]))
        return np.broadcast_to(rows, scene.shape)
