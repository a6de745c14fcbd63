"""Antennas and sources that are elsewhere are seen there, whatever else is wrong with the sky or with the beams."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray
from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.instrument.antenna_pointing import AntennaPointing
from hydrabeam_mpi.effects.instrument.antenna_positions import AntennaPositions
from hydrabeam_mpi.effects.instrument.orientation import Orientation
from hydrabeam_mpi.effects.instrument.timestamp import Timestamp
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.interface.place import Place, PlacesElsewhere
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.shared.displaced import ARCMIN, TurnedPositions, TurningSky, rotate
from hydrabeam_mpi.effects.shared.displacing import with_displacing
from hydrabeam_mpi.effects.shared.in_time import InTime
from hydrabeam_mpi.effects.shared.time_laws import Smooth
from hydrabeam_mpi.effects.sky.ionosphere import SteadyRefraction
from hydrabeam_mpi.random import generator
from tests.effects.direct import assert_same, row_vectors, visibilities
from tests.effects.small import small_block, small_setup

POSITIONS, SHIFTS = AntennaPositions(), np.zeros((7, 3))
SHIFTS[2], SHIFTS[5] = (0.2, -0.1, 0.6), (0.0, 0.3, 0.1)


def block_with(*effects: tuple[Effect, FloatArray]) -> RowBlock:
    return with_displacing(small_block(small_setup()), [(POSITIONS, SHIFTS.ravel()), *effects])


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
    assert with_displacing(unmoved, [(POSITIONS, np.zeros(21))]) is unmoved


def turned(block: RowBlock, effect: TurningSky | InTime, x: FloatArray) -> dict[int, FloatArray]:
    """The rotation of each time."""
    if isinstance(effect, InTime):
        assert isinstance(effect.effect, TurningSky)
        now = effect._at_times(block.setup, x, block.times)
        each = [effect.effect.rotations(block.at_time(t), one)[0] for t, one in enumerate(now)]
    else:
        each = list(effect.rotations(block, x))
    return dict(zip(block.times.tolist(), each, strict=True))


DRIFT = InTime(Timestamp(), Smooth(orders=(1,))).in_full(small_setup())
TURNS: list[tuple[TurningSky | InTime, FloatArray]] = [
    (Orientation(), np.array([3.0, -5.0, 20.0])),
    (DRIFT, np.array([40.0])),
    (Orientation("stars").in_full(small_setup()), np.array([-6.0, 2.0, 9.0])),
    (SteadyRefraction(), np.array([4.0, -7.0])),
]


def turned_by_all(block: RowBlock, directions: FloatArray, itime: int) -> FloatArray:
    for effect, x in TURNS:
        directions = rotate(directions, turned(block, effect, x)[itime])
    return directions


def test_turns_follow_each_other() -> None:
    """One that drifts, one among the stars and one by refraction, each on what the others leave."""
    block = with_displacing(small_block(small_setup()), TURNS)
    total = block.vis + sum(block.added_by(effect, x) for effect, x in TURNS)
    expected = visibilities(block, turn=lambda directions, itime: turned_by_all(block, directions, itime))
    assert_same(total, expected, block)
    apart = block.vis + sum(effect.added(block, x) for effect, x in TURNS)
    assert np.abs(apart - expected).max() > 0.01 * np.abs(block.vis).max()


def test_a_sky_that_is_turned_is_shifted_where_it_is_then() -> None:
    turn, shift = (Orientation(), np.array([3.0, -5.0, 20.0])), (SteadyRefraction("flat"), np.array([1.4, -1.7]))
    # At its first time no source is so near the horizon that it sets.
    block = with_displacing(small_block(small_setup()).at_time(0), [turn, shift])
    by = ARCMIN * (block.setup.reference_freq / block.freq) ** 2 * shift[1]

    def both(directions: FloatArray, _: int) -> FloatArray:
        east, north, _up = rotate(directions, ARCMIN * turn[1]) + np.array([*by, 0.0])[:, np.newaxis]
        return np.stack([east, north, np.sqrt(1 - east**2 - north**2)])

    total = block.vis + sum(block.added_by(effect, x) for effect, x in (turn, shift))
    assert_same(total, visibilities(block, turn=both), block)


def test_tilted_antennas_and_antennas_elsewhere_see_the_sky_that_is_turned() -> None:
    """Tilts are worked out on what all others make; the sky turns over antennas that have been moved."""
    tilts, x = AntennaPointing(), generator(9, "tilts").standard_normal(14)
    block = with_displacing(small_block(small_setup()), [(POSITIONS, SHIFTS.ravel()), (tilts, x), *TURNS])
    adding: list[tuple[Effect, FloatArray]] = [(POSITIONS, SHIFTS.ravel()), *TURNS]
    total = block.vis + sum(block.added_by(effect, own) for effect, own in adding)
    expected = visibilities(
        block, true_vectors(block), lambda directions, itime: turned_by_all(block, directions, itime)
    )
    assert_same(total, expected, block)
    # The same scene with the antennas and the sources where they are.
    positions = block.positions
    for effect, own in TURNS:
        positions = TurnedPositions(positions, turned(block, effect, own))
    there = replace(small_block(small_setup()), positions=positions, places=None)
    antpos = block.antpos + SHIFTS
    there = replace(there, own_vectors=true_vectors(block), own_antpos=antpos)
    there = replace(there, groups=np.arange(21), member=np.arange(21))
    assert_same(block.added_by(tilts, x), tilts.added(there, x), block)


@pytest.mark.parametrize("number", range(len(TURNS) + 1))
def test_columns_are_the_slopes_of_all_that_is_added(number: int) -> None:
    """To a few thousandths, as turns of an arcmin nearly commute."""
    model: list[tuple[Effect, FloatArray]] = [(one, 0.1 * x) for one, x in (*TURNS, (POSITIONS, SHIFTS.ravel()))]
    effect, x = model[number]
    scene, step = small_block(small_setup()), 1e-3

    def total(own: FloatArray) -> ComplexArray:
        changed = [(one, own if one is effect else value) for one, value in model]
        block = with_displacing(scene, changed)
        return np.asarray(sum(block.added_by(*one) for one in changed))

    block = with_displacing(scene, model)
    columns = block.columns_of(effect, x).of_rows(block.member).matrix()
    dense = columns if isinstance(columns, np.ndarray) else columns.toarray()
    for i, unit in enumerate(step * np.eye(len(x))):
        slope = (total(x + unit) - total(x - unit)) / (2 * step)
        assert np.abs(dense[:, i] - slope.ravel()).max() < 3e-3 * np.abs(slope).max()


def test_what_is_kept_of_displaced_skies_changes_nothing_and_serves_blocks_that_follow() -> None:
    """For other parameters, another channel, tilted beams and antennas that are elsewhere, in any order."""
    kept, places = PlacesElsewhere(2), dict[int, Place]()
    tilts, x = AntennaPointing(), generator(9, "tilts").standard_normal(14)
    moved: list[tuple[Effect, FloatArray]] = [(POSITIONS, SHIFTS.ravel())]
    turns = [(effect, own / n) for n in (1, 2, 1) for effect, own in TURNS]
    scenes = [(channel, [*move, turn]) for turn in turns for channel in (0, 1) for move in ([], moved, [])]
    for channel, model in scenes:
        alone = with_displacing(small_block(small_setup(), channel), model)
        sharing = replace(alone, places=places, keeps_waves=True, elsewhere=kept)
        for effect, own in (model[-1], (tilts, x)):
            expected = alone.added_by(effect, own)
            np.testing.assert_allclose(sharing.added_by(effect, own), expected, atol=1e-12 * np.abs(expected).max())
        turning, own = model[-1]
        columns = [one.columns_of(turning, own).of_rows(one.member).values for one in (alone, sharing)]
        np.testing.assert_allclose(columns[1], columns[0], atol=1e-12 * np.abs(columns[0]).max())
    effect, own = scenes[-1][1][-1]
    again = replace(with_displacing(small_block(small_setup(), 1), [(effect, own)]), places=places, elsewhere=kept)
    assert again.displaced_by(effect, own.copy()).places is sharing.displaced_by(effect, own).places
    assert kept.of(1, places, effect, own + 1) is not kept.of(1, places, effect, own)
    # The latest two are kept, of each channel.
    older = kept.of(1, places, effect, own)
    for more in (1, 2):
        kept.of(1, places, effect, own + more)
    kept.of(0, places, effect, own)
    assert kept.of(1, places, effect, own) is not older
    # None where there is no room.
    assert PlacesElsewhere().of(0, places, effect, own) == {}


def test_what_does_not_see_the_sky_has_it_as_it_is() -> None:
    block = with_displacing(small_block(small_setup()), TURNS)
    assert block.seen_by(AntennaGains()) is block
    # All others see one sky, which is made once.
    seen = block.seen_by(TURNS[0][0])
    assert seen.positions is not block.positions
    assert seen is block.seen_by(POSITIONS) is block.seen_by(AntennaPointing()) is seen.seen_by(TURNS[1][0])
    still = small_block(small_setup())
    assert with_displacing(still, [(Orientation(), np.zeros(3))]) is still
    assert with_displacing(still, [(Orientation("array"), np.ones(3))]) is still
