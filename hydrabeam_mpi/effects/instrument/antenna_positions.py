"""Antennas that do not stand where they are said to stand."""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.data.observation import C_M_PER_S, BoolArray, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.instrument.array_scale import PERCENT, ArrayScale
from hydrabeam_mpi.effects.instrument.orientation import Orientation
from hydrabeam_mpi.effects.interface.effect import Columns, Effect, Parameters
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.interface.sources import Sources
from hydrabeam_mpi.effects.shared.beam_visibilities import integrate_on
from hydrabeam_mpi.effects.shared.displaced import ARCMIN, need_real_beam
from hydrabeam_mpi.effects.shared.per_antenna import antenna_parameters, common_values, row_parameters

LEAST_OF_ARRAY = 4
"""Antennas that may be said to be elsewhere together: three can be anywhere by a turn, a shift and little else."""
MOST_BESIDE_WHOLE = 3
"""Antennas that may stand elsewhere besides, where the others are elsewhere together: each number of them is a fit."""
ROUNDS_OF_WEIGHTS = 20
"""Of the least sum of distances, which is found by weights of one over these: it is told to a thousandth by then."""


class AntennaPositions(Effect):
    """Each antenna is displaced a little, the same at all times and frequencies.

    What all antennas have in common changes nothing. Phases grow with the frequency by themselves, as displacements are
    in metres.
    """

    kind = "antenna_positions"
    title = "antenna positions"
    of_both_feeds = True
    shared = True
    moves_antennas = True

    def not_applicable(self, setup: ObservingSetup) -> str | None:
        """Refuse complex beams."""
        return need_real_beam(setup)

    def parameters(self, setup: ObservingSetup) -> Parameters:
        """Return the displacement of every antenna towards East, North and Up."""
        return antenna_parameters(setup, ("displaced East", "displaced North", "displaced Up"), "m", 0.1)

    def sky_columns(self, sources: Sources) -> FloatArray:
        """Return the beam, and the beam times the unit vector, (4, Nsrc)."""
        beam = sources.beam[np.newaxis]
        return np.concatenate([beam, beam * sources.enu])

    def degenerate_directions(self, setup: ObservingSetup) -> FloatArray:
        """Return the shift that all antennas have in common, (n_directions, n_params)."""
        return common_values(len(setup.antennas_in_use), 3)

    def columns(self, block: RowBlock, x: FloatArray) -> Columns:
        """Return minus and plus i k times the moments of the unit vector, for a row's first and second antenna.

        ``x`` is (n_params,).
        """
        moments = block.spread(block.integral(self)[..., 1:])
        moved, *places = self._moved(block, x)
        if len(moved):
            moments[:, moved] = integrate_on(block, lambda sources: sources.beam * sources.enu, *places)
        wavenumber = 2 * np.pi * block.freq / C_M_PER_S
        values = 1j * wavenumber * np.concatenate([-moments, moments], axis=-1)
        return Columns(values, 3 * len(block.setup.antennas_in_use), row_parameters(block, 3))

    def added(self, block: RowBlock, x: FloatArray) -> ComplexArray:
        """Return the visibilities on the true vectors minus those on the assumed ones, (Ntimes, Nbls)."""
        moved, *places = self._moved(block, x)
        change = np.zeros(block.shape, dtype=complex)
        if len(moved):
            after = integrate_on(block, lambda sources: sources.beam[np.newaxis], *places)[..., 0]
            change[:, moved] = after - block.integral(self)[:, block.member[moved], 0]
        return change

    def displacements(self, setup: ObservingSetup, x: FloatArray) -> FloatArray:
        """Return by how much each of the observation's antennas is elsewhere, (Nants, 3), metres ENU."""
        shifts: FloatArray = np.zeros_like(setup.observation.antpos)
        shifts[setup.antennas_in_use] = x.reshape(-1, 3)
        return shifts

    def simpler_elements(
        self, setup: ObservingSetup, x: FloatArray, std: FloatArray
    ) -> list[tuple[BoolArray, Effect, FloatArray]]:
        """Return all antennas as those of an array that is turned, or of another size, whichever comes nearer.

        After that all but those that fit least into it.
        """
        places, shifts = setup.observation.antpos[setup.antennas_in_use], x[0].reshape(-1, 3)
        _, away = _nearest_whole(setup, places, shifts)
        furthest = np.argsort(-away)[: min(MOST_BESIDE_WHOLE, len(away) - LEAST_OF_ARRAY)]
        found: list[tuple[BoolArray, Effect, FloatArray]] = []
        for n_beside in range(len(furthest) + 1 if len(away) >= LEAST_OF_ARRAY else 0):
            together = ~np.isin(np.arange(len(away)), furthest[:n_beside])
            whole, _ = _nearest_whole(setup, places[together], shifts[together])
            found.append((np.repeat(together, 3), *whole))
        return found

    def _moved(self, block: RowBlock, x: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
        """Return the rows that are elsewhere, their true vectors, (Nmoved, 3), and all true places, (Nants, 3)."""
        shifts = self.displacements(block.setup, x)
        change = shifts[block.ant2] - shifts[block.ant1]
        moved = np.flatnonzero(change.any(axis=1))
        return moved, block.vectors[block.member[moved]] + change[moved], block.antpos + shifts


def _nearest_whole(
    setup: ObservingSetup, places: FloatArray, shifts: FloatArray
) -> tuple[tuple[Effect, FloatArray], FloatArray]:
    """Return an array that is turned, or of another size, with its numbers, and how far each antenna is from that.

    Of the two that with the least sum of these distances, metres, (Nants,). ``places`` and ``shifts`` are (Nants, 3).
    """
    vectors = (places - places.mean(axis=0)).T
    # An array seen by a sky that is turned by w has moved by r x w.
    turned = np.array([np.cross(vectors, axis, axisa=0).T for axis in np.eye(3)])
    turn, from_turn = _nearest(turned, shifts)
    size, from_size = _nearest(vectors[np.newaxis], shifts)
    if from_size.sum() < from_turn.sum():
        return (ArrayScale(), size / PERCENT), from_size
    return (Orientation("array").in_full(setup), turn / ARCMIN), from_turn


def _nearest(moved: FloatArray, shifts: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the numbers, (n,), with which antennas come nearest to where they are, and how far each is from there.

    The sum of distances is the least, so that a few that are elsewhere do not count more than others do; a shift of all
    is free. By each number antennas have ``moved``, (n, 3, Nants); ``shifts`` are (Nants, 3), distances (Nants,).
    """
    n, one = len(moved), np.ones(len(shifts))
    shifted = np.eye(3)[:, :, np.newaxis] * one
    design = np.concatenate([moved, shifted]).transpose(2, 1, 0)
    weights = one
    for _ in range(ROUNDS_OF_WEIGHTS):
        root = np.sqrt(weights)[:, np.newaxis]
        weighted = (root[..., np.newaxis] * design).reshape(-1, n + 3)
        found = np.linalg.lstsq(weighted, (root * shifts).ravel(), rcond=None)[0]
        away = np.linalg.norm(shifts - design @ found, axis=1)
        weights = 1 / np.maximum(away, 1e-3 * max(float(away.max()), 1e-12))
    return found[:n], away
