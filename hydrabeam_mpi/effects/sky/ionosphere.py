"""Ionospheric refraction in bulk: the whole sky is shifted by an angle proportional to the wavelength squared."""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray, IntArray
from hydrabeam_mpi.effects.interface.effect import Columns, Parameters
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.shared.displaced import TILTS, TurningSky, rotation_rate

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
    of_the_sky = True

    def parameters(self, setup: ObservingSetup) -> Parameters:
        """Return the shifts towards East and North at the reference frequency, for each time in use."""
        n_times = len(setup.times)
        jds = setup.observation.times[setup.times]
        names = [f"shift towards {where} at JD {jd:.5f}" for jd in jds for where in ("East", "North")]
        return Parameters.of(names, "arcmin", 1.0, np.repeat(np.arange(n_times), 2))

    def rotations(self, block: RowBlock, x: FloatArray) -> FloatArray:
        """Return the rotation of each time at the block's frequency, (Ntimes, 3)."""
        shifts = x.reshape(-1, 2)[scene_times(block)]
        return np.asarray(self._per_arcmin(block) * shifts @ TILTS.T)

    def columns(self, block: RowBlock, x: FloatArray) -> Columns:
        """Return what small further shifts of a time do to it; ``x`` is (n_params,)."""
        turns = np.array([rotation_rate(rotation) @ TILTS for rotation in self.rotations(block, x)])
        values = self._per_arcmin(block) * (self.rates(block, x) @ turns)
        index = 2 * scene_times(block)[:, np.newaxis, np.newaxis] + np.arange(2)
        return Columns(values, 2 * len(block.setup.times), index, by_group=True)

    @staticmethod
    def _per_arcmin(block: RowBlock) -> float:
        """Return the shift at the block's frequency, in radians, that is one arcmin at the reference frequency."""
        return ARCMIN * (block.setup.reference_freq / block.freq) ** 2


def scene_times(block: RowBlock) -> IntArray:
    """Return the position of each of the block's times among the setup's, (Ntimes,)."""
    times = block.setup.times
    order = np.argsort(times)
    return order[np.searchsorted(times, block.times, sorter=order)]
