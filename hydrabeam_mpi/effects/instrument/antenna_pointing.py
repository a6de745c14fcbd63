"""Antennas that do not point where they should."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.effect import Columns, Effect, Parameters
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.interface.sources import Sources
from hydrabeam_mpi.effects.shared.antenna_beams import added_by_beams, slopes_by_beams
from hydrabeam_mpi.effects.shared.displaced import TILTS, need_real_beam, rotation_rate, seen_turned
from hydrabeam_mpi.effects.shared.per_antenna import antenna_parameters, common_values, row_parameters

DEGREE = np.pi / 180


class AntennaPointing(Effect):
    """Each antenna's beam is tilted towards East and North, the same at all times and frequencies.

    The power beam of a baseline is the product of its antennas' voltage beams, the positive roots of their power beams
    (`antenna_beams`): for small tilts half the sum of the two antennas' power beams. Tilts are exact rotations of the
    beam about a horizontal axis. A tilt that all antennas have in common is a beam that points elsewhere, which the
    beam's own freedom takes up.
    """

    kind = "antenna_pointing"
    title = "antenna pointing"
    shared = True
    laws: ClassVar = {"smooth": "antenna pointing that drifts", "piecewise": "antenna pointing that jumps"}

    def not_applicable(self, setup: ObservingSetup) -> str | None:
        """Refuse complex beams."""
        return need_real_beam(setup)

    def parameters(self, setup: ObservingSetup) -> Parameters:
        """Return the tilts of every antenna towards East and North."""
        return antenna_parameters(setup, ("tilted towards East", "tilted towards North"), "deg", 0.1)

    def sky_columns(self, sources: Sources) -> FloatArray:
        """Return how the beam changes as it is tilted towards East and North, (2, Nsrc) per radian."""
        return -TILTS.T @ sources.torque

    def degenerate_directions(self, setup: ObservingSetup) -> FloatArray:
        """Return the tilts that all antennas have in common, (n_directions, n_params)."""
        return common_values(len(setup.antennas_in_use), 2)

    def common_in_time(self, setup: ObservingSetup) -> tuple[tuple[str, ...], FloatArray]:
        """Return these: what they change is told from a beam that does not change."""
        names = ("all antennas tilted towards East", "all antennas tilted towards North")
        return names, np.tile(np.eye(2), len(setup.antennas_in_use))

    def columns(self, block: RowBlock, x: FloatArray) -> Columns:
        """Return what tilting a row's first and second antenna further does; ``x`` is (n_params,)."""
        rotations = _rotations(x)
        tilted, distinct, which = _tilted(rotations)
        by_side: ComplexArray
        if len(tilted):
            by_torque = np.array([-(rotation_rate(-rotation) @ TILTS).T for rotation in distinct])

            def beams(sources: Sources) -> tuple[FloatArray, FloatArray]:
                powers, torques = [], []
                for seen in seen_turned(sources, distinct):
                    powers.append(seen.beam.reshape(-1, len(sources.za)))
                    torques.append(seen.torque.reshape(3, -1, len(sources.za)).transpose(1, 0, 2))
                return np.concatenate(powers)[which], (by_torque @ np.concatenate(torques))[which]

            by_side = slopes_by_beams(block, tilted, beams, self.sky_columns)
        else:
            by_side = np.repeat(0.5 * block.spread(block.integral(self))[:, :, np.newaxis], 2, axis=2)
        return Columns(DEGREE * by_side.reshape(*block.shape, 4), 2 * len(rotations), row_parameters(block, 2))

    def added(self, block: RowBlock, x: FloatArray) -> ComplexArray:
        """Return what the antennas' tilts change, (Ntimes, Nbls)."""
        tilted, distinct, which = _tilted(_rotations(x))

        def beams(sources: Sources) -> FloatArray:
            seen = [one.beam for one in seen_turned(sources, distinct)]
            return np.concatenate(seen).reshape(len(distinct), -1)[which]

        return added_by_beams(block, tilted, beams)


def _rotations(x: FloatArray) -> FloatArray:
    """Return the antennas' rotation vectors, (Nants, 3)."""
    return np.asarray(DEGREE * x.reshape(-1, 2) @ TILTS.T)


def _tilted(rotations: FloatArray) -> tuple[IntArray, FloatArray, IntArray]:
    """Return which antennas are tilted, (n,), their distinct rotations, and which of these each has, (n,).

    What tilts all antennas alike takes no longer than what tilts one.
    """
    tilted = np.flatnonzero(rotations.any(axis=1))
    distinct, which = np.unique(rotations[tilted], axis=0, return_inverse=True)
    return tilted, distinct, which.reshape(-1)
