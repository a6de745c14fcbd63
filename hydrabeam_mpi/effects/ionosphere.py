"""Ionospheric refraction in bulk: the whole sky is shifted by an angle proportional to the wavelength squared."""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.base import Columns, Parameters
from hydrabeam_mpi.effects.displaced import TILTS, TurningSky, rotation_rate
from hydrabeam_mpi.effects.experiment import Experiment
from hydrabeam_mpi.effects.scene import Scene

ARCMIN = np.pi / 180 / 60


class Ionosphere(TurningSky):
    """At each time, all sources are seen shifted towards East and North, by angles that go as lambda^2.

    The shift is a rotation about a horizontal axis, so that sources at the zenith move by the whole of it. A wedge of
    electrons over the array shifts everything that is high in the sky alike; what it does near the horizon, and what
    changes over the sky, is not described.
    """

    kind = "ionosphere"
    title = "ionospheric refraction"
    local = "times"

    def parameters(self, experiment: Experiment) -> Parameters:
        """Return the shifts towards East and North at the reference frequency, for each time in use."""
        n_times = len(experiment.times)
        jds = experiment.observation.times[experiment.times]
        names = [f"shift towards {where} at JD {jd:.5f}" for jd in jds for where in ("East", "North")]
        return Parameters.of(names, "arcmin", 1.0, np.repeat(np.arange(n_times), 2))

    def rotations(self, scene: Scene, x: FloatArray) -> FloatArray:
        """Return the rotation of each time at the scene's frequency."""
        shifts = x.reshape(-1, 2)[scene_times(scene)]
        return np.asarray(self._per_arcmin(scene) * shifts @ TILTS.T)

    def columns(self, scene: Scene, x: FloatArray) -> Columns:
        """Return what small further shifts of a time do to it."""
        turns = np.array([rotation_rate(rotation) @ TILTS for rotation in self.rotations(scene, x)])
        values = self._per_arcmin(scene) * (self.rates(scene, x) @ turns)
        index = 2 * scene_times(scene)[:, np.newaxis, np.newaxis] + np.arange(2)
        return Columns(values, 2 * len(scene.experiment.times), index, by_group=True)

    @staticmethod
    def _per_arcmin(scene: Scene) -> float:
        """Return the shift at the scene's frequency, in radians, that is one arcmin at the reference frequency."""
        return ARCMIN * (scene.experiment.reference_freq / scene.freq) ** 2


def scene_times(scene: Scene) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Return the position of each of the scene's times among the experiment's, (Ntimes,)."""
    times = scene.experiment.times
    order = np.argsort(times)
    return order[np.searchsorted(times, scene.times, sorter=order)]
