"""Antennas that are elsewhere see the sky there, whatever else is wrong with it or with their beams."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.instrument.antenna_pointing import AntennaPointing
from hydrabeam_mpi.effects.instrument.antenna_positions import AntennaPositions
from hydrabeam_mpi.effects.instrument.orientation import Orientation
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.shared.displaced import ARCMIN, rotate
from hydrabeam_mpi.effects.shared.moved_antennas import with_moved_antennas
from hydrabeam_mpi.random import generator
from tests.effects.direct import assert_same, row_vectors, visibilities
from tests.effects.small import small_block, small_setup

POSITIONS, SHIFTS = AntennaPositions(), np.zeros((7, 3))
SHIFTS[2], SHIFTS[5] = (0.2, -0.1, 0.6), (0.0, 0.3, 0.1)


def block_with(*effects: tuple[Effect, FloatArray]) -> RowBlock:
    return with_moved_antennas(small_block(small_setup()), [(POSITIONS, SHIFTS.ravel()), *effects])


def true_vectors(block: RowBlock) -> FloatArray:
    """Vectors between the antennas' true places, in the sense of the groups, (Nbls, 3)."""
    return row_vectors(block) + SHIFTS[block.ant2] - SHIFTS[block.ant1]


def test_a_sky_that_is_turned_is_seen_from_where_antennas_are() -> None:
    """Two phases of half a radian make more together than one after the other."""
    turn = np.array([3.0, -5.0, 20.0])
    effect = Orientation()
    block = block_with((effect, turn))
    total = block.vis + block.added_by(POSITIONS, SHIFTS.ravel()) + block.added_by(effect, turn)
    expected = visibilities(block, true_vectors(block), lambda directions, _: rotate(directions, ARCMIN * turn))
    assert_same(total, expected, block)
    block = small_block(small_setup())
    apart = block.vis + POSITIONS.added(block, SHIFTS.ravel()) + effect.added(block, turn)
    assert np.abs(apart - expected).max() > 0.01 * np.abs(block.vis).max()


def test_tilted_antennas_have_the_product_of_their_beams_where_they_are() -> None:
    """As of antennas whose positions are the true ones."""
    effect, x = AntennaPointing(), generator(9, "tilts").standard_normal(14)
    block = block_with((effect, x))
    found = block.added_by(effect, x)
    setup = small_setup()
    moved = replace(setup.observation, antpos=setup.observation.antpos + SHIFTS)
    there = small_block(replace(setup, observation=moved))
    # In the sense of the groups that they were in.
    there = replace(there, own_vectors=true_vectors(block), groups=np.arange(21), member=np.arange(21))
    assert_same(found, effect.added(there, x), block)


@pytest.mark.parametrize("effect", [AntennaPointing(), Orientation()])
def test_columns_are_of_baselines_as_they_are(effect: Effect) -> None:
    step, n = 1e-4, len(effect.parameters(small_setup()))
    x = 0.3 * generator(8, "moved").standard_normal(n)
    block = block_with((effect, x))
    block.integrate_for([effect, POSITIONS])
    columns = block.columns_of(effect, x)
    assert not columns.by_group
    matrix = columns.matrix()
    dense = matrix if columns.index is None else matrix.toarray()
    for number in range(n):
        more = step * np.eye(n)[number]
        slope = (block.added_by(effect, x + more) - block.added_by(effect, x - more)) / (2 * step)
        assert np.abs(dense[:, number] - slope.ravel()).max() < 2e-5 * np.abs(dense).max()


def test_redundant_baselines_of_other_antennas_stay_one() -> None:
    block = block_with()
    seen = block.seen_by(Orientation())
    moved = np.isin(block.ant1, (2, 5)) | np.isin(block.ant2, (2, 5))
    stays = block.member[~moved]
    assert len(seen.groups) == len(np.unique(stays)) + moved.sum() == seen.member.max() + 1
    same_as_before = stays == stays[:, np.newaxis]
    np.testing.assert_array_equal(seen.member[~moved] == seen.member[~moved][:, np.newaxis], same_as_before)
    np.testing.assert_allclose(seen.vectors[seen.member], true_vectors(block), rtol=0, atol=1e-9)


def test_what_multiplies_and_what_moves_them_have_the_rows_as_they_are() -> None:
    block = block_with()
    assert block.seen_by(AntennaGains()) is block
    assert block.seen_by(POSITIONS) is block
    unmoved = small_block(small_setup())
    assert with_moved_antennas(unmoved, [(POSITIONS, np.zeros(21))]) is unmoved
