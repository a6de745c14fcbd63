"""Antennas that do not stand where they are said to stand."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.base import Columns, Effect, Parameters
from hydrabeam_mpi.effects.displaced import need_real_beam
from hydrabeam_mpi.effects.experiment import Experiment
from hydrabeam_mpi.effects.per_antenna import antenna_parameters, common_values, row_antennas, row_parameters
from hydrabeam_mpi.effects.scene import Scene
from hydrabeam_mpi.effects.sources import Sources
from hydrabeam_mpi.model.fringes import C_M_PER_S

_VECTORS_AT_ONCE = 2048


class AntennaPositions(Effect):
    """Each antenna stands a little off, the same at all times and frequencies.

    What all antennas have in common changes nothing. Phases grow with the frequency by themselves, as displacements are
    in metres.
    """

    kind = "antenna_positions"
    title = "antenna positions"
    shared = True

    def refusal(self, experiment: Experiment) -> str | None:
        """Refuse complex beams."""
        return need_real_beam(experiment)

    def parameters(self, experiment: Experiment) -> Parameters:
        """Return the displacement of every antenna towards East, North and Up."""
        return antenna_parameters(experiment, ("displaced East", "displaced North", "displaced Up"), "m", 0.1)

    def sky_columns(self, sources: Sources) -> FloatArray:
        """Return the beam, and the beam times the unit vector, (4, Nsrc)."""
        beam = sources.beam[np.newaxis]
        return np.concatenate([beam, beam * sources.enu])

    def undecidable(self, experiment: Experiment) -> FloatArray:
        """Return the shift that all antennas have in common."""
        return common_values(len(experiment.antennas_in_use), 3)

    def columns(self, scene: Scene, x: FloatArray) -> Columns:
        """Return minus and plus i k times the moments of the unit vector, for a row's first and second antenna."""
        moments = scene.spread(scene.integrals[self.kind][..., 1:])
        moved, vectors = self._moved(scene, x)
        if len(moved):
            moments[:, moved] = _integrate(scene, lambda sources: sources.beam * sources.enu, vectors)
        wavenumber = 2 * np.pi * scene.freq / C_M_PER_S
        values = 1j * wavenumber * np.concatenate([-moments, moments], axis=-1)
        return Columns(values, 3 * len(scene.experiment.antennas_in_use), row_parameters(scene, 3))

    def added(self, scene: Scene, x: FloatArray) -> ComplexArray:
        """Return the visibilities on the true vectors minus those on the assumed ones, (Ntimes, Nbls)."""
        moved, vectors = self._moved(scene, x)
        change = np.zeros(scene.shape, dtype=complex)
        if len(moved):
            after = _integrate(scene, lambda sources: sources.beam[np.newaxis], vectors)[..., 0]
            change[:, moved] = after - scene.integrals[self.kind][:, scene.member[moved], 0]
        return change

    @staticmethod
    def _moved(scene: Scene, x: FloatArray) -> tuple[IntArray, FloatArray]:
        """Return the rows whose vector is not what it should be, and their true vectors, (Nmoved, 3)."""
        first, second = row_antennas(scene).T
        shifts = x.reshape(-1, 3)
        change = shifts[second] - shifts[first]
        moved = np.flatnonzero(change.any(axis=1))
        return moved, scene.vectors[scene.member[moved]] + change[moved]


def _integrate(scene: Scene, columns: Callable[[Sources], FloatArray], vectors: FloatArray) -> ComplexArray:
    """Integrate over the sky for many vectors, of which no two are the same, in parts that fit in memory."""
    n_parts = -(-len(vectors) // _VECTORS_AT_ONCE)
    parts = [scene.integrate(columns, part) for part in np.array_split(vectors, n_parts)]
    return np.concatenate(parts, axis=1)
