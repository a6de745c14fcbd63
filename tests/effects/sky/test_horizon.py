from dataclasses import replace

import numpy as np
import pytest

from hydrabeam_mpi.data.observation import FloatArray, IntArray
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.sky.horizon import AT_MOST, HEIGHTS, HIGHEST, LENGTHS, SECTORS, STARTS, STRIPS, Horizon
from hydrabeam_mpi.model.positions import RotatedPositions, SourcePositions
from hydrabeam_mpi.random import complex_normal, generator
from tests.effects.small import small_block, small_setup


def wide_scene(n_sources: int = 1000) -> tuple[ObservingSetup, RowBlock]:
    """Many sources, so that there are some near the horizon, where the beam is told from that of the sky."""
    setup = replace(small_setup(n_sources=n_sources), positions=RotatedPositions)
    return setup, small_block(setup)


def number_of(first: float, last: float, height: float) -> int:
    """Return the hypothesis of a wall."""
    start, length = round(first / 360 * SECTORS) % SECTORS, round((last - first) / 360 * SECTORS)
    window = np.flatnonzero((start == STARTS) & (length == LENGTHS))[0]
    return int(window) * HEIGHTS + round(height / HIGHEST * HEIGHTS) - 1


def opaque(effect: Horizon, setup: ObservingSetup) -> FloatArray:
    """Return parameters with which the walls let nothing through, right up to their edges."""
    return np.where(effect.parameters(setup).nonlinear, 0.0, -1.0)


def test_walls_are_elements_and_bring_their_rims() -> None:
    setup, _ = wide_scene()
    effect = Horizon().at(setup, np.array([number_of(60, 120, 6), number_of(0, 360, 2)]))
    parameters = effect.parameters(setup)
    assert parameters.names[:2] == ("elevation 0-6 deg, az 60-120 deg", "elevation 0-2 deg, all azimuths")
    assert len(set(parameters.names)) == len(parameters)
    # Up and down, and at both ends of what does not stand all around.
    assert np.bincount(parameters.element).tolist() == [1 + 6 * STRIPS, 1 + 2 * STRIPS]
    assert parameters.nonlinear.tolist() == [False] * 2 + [True] * (8 * STRIPS)
    assert parameters.trials == effect.n_hypotheses(setup) == (SECTORS * (SECTORS - 1) + 1) * HEIGHTS


def test_no_more_is_lost_than_there_is() -> None:
    setup, _ = wide_scene()
    effect = Horizon().at(setup, np.array([number_of(60, 120, 6), number_of(200, 300, 2)]))
    for strength in (0.1, 1.0, 10.0):
        x = effect.draw(setup, generator(2, "horizon"), strength)
        assert (x[:2] < 0).all()
        assert (x >= -1).all()
        assert not x[2:].any()


def test_strips_have_few_sources_and_lie_along_the_edges() -> None:
    setup, block = wide_scene()
    effect = Horizon().at(setup, np.array([number_of(330, 390, 5)]))
    strips = np.array([strip for _, strip in effect.strips])
    upward = strips[(strips[:, 0] == 330) & (strips[:, 1] == 390)]
    assert len(upward) == 2 * STRIPS
    beyond = upward[upward[:, 2] >= 5]
    np.testing.assert_array_equal(beyond[1:, 2], beyond[:-1, 3])
    assert beyond[0, 2] == 5
    places = [np.rad2deg(block.positions.above_horizon(t)[1:]) for t in range(6)]
    za, az = np.concatenate(places, axis=1)
    within = (az >= 330) | (az < 30)
    for _, _, lo, hi in beyond:
        assert 1 <= np.sum(within & (90 - za >= lo) & (90 - za < hi)) <= 2
    sideways = strips[strips[:, 2] == 0]
    assert (sideways[:, 3] == 5).sum() == 4 * STRIPS
    assert {330.0, 390.0} <= set(sideways[:, :2].ravel())


class Behind:
    """Positions from which the ground hides all below an elevation in a stretch of azimuth, degrees."""

    def __init__(self, positions: SourcePositions, wall: tuple[float, float, float]) -> None:
        self.positions, (self.first, self.last, self.height) = positions, wall

    def above_horizon(self, itime: int, below: float = 0.0) -> tuple[IntArray, FloatArray, FloatArray]:
        index, za, az = self.positions.above_horizon(itime)
        turns = np.rad2deg(az) + 360 * np.arange(-1, 2)[:, np.newaxis]
        inside = ((turns >= self.first) & (turns < self.last)).any(axis=0)
        seen = ~inside | (90 - np.rad2deg(za) >= self.height)
        return index[seen], za[seen], az[seen]


@pytest.mark.parametrize("wall", [(60, 120, 10), (330, 405, 5), (0, 360, 10), (0, 360, 2.25), (300, 305, 8.5)])
def test_hidden_sky_equals_fewer_sources(wall: tuple[float, float, float]) -> None:
    setup, block = wide_scene(4000)
    effect = Horizon().at(setup, np.array([number_of(*wall)]))
    x = opaque(effect, setup)
    behind = replace(block, positions=Behind(block.positions, wall))
    expected = block.spread(behind.integrate(lambda sources: sources.beam[np.newaxis])[..., 0])
    largest = np.abs(block.vis).max()
    assert np.abs(expected - block.vis).max() > 1e-6 * largest
    np.testing.assert_allclose(block.vis + effect.added(block, x), expected, rtol=0, atol=1e-12 * largest)
    factored = replace(block, sky_effects=[(effect, x)])
    seen = factored.spread(factored.integrate(lambda sources: sources.beam[np.newaxis])[..., 0])
    np.testing.assert_allclose(seen, expected, rtol=0, atol=1e-12 * largest)


def test_walls_of_two_rounds_add_up() -> None:
    """Together they transmit what one effect with both would, also where they overlap."""
    setup, block = wide_scene()
    walls = [number_of(60, 120, 6), number_of(90, 180, 4)]
    both = Horizon().at(setup, np.array(walls))
    n_strips = len(both.strips)
    one, two = (Horizon(both.walls[i : i + 1], [(0, box) for k, box in both.strips if k == i]) for i in (0, 1))
    x = np.concatenate([[-0.6, -0.3], np.zeros(n_strips)])
    together = replace(block, sky_effects=[(both, x)])
    apart = replace(
        block,
        sky_effects=[
            (effect, np.append(value, np.zeros(len(effect.strips)))) for effect, value in ((one, -0.6), (two, -0.3))
        ],
    )
    for t in range(6):
        np.testing.assert_allclose(apart.sources(t).flux_without(), together.sources(t).flux_without(), rtol=1e-14)
        np.testing.assert_array_equal(apart.sources(t).flux_without("horizon"), block.sources(t).flux)


def test_nothing_that_stands_there_makes_sources_brighter() -> None:
    setup, _ = wide_scene()
    effect = Horizon().at(setup, np.array([number_of(60, 120, 6), number_of(300, 390, 3)]))
    hidden = np.array([opaque(effect, setup)] * 2)
    std = np.full(hidden.shape, 0.1)
    assert not effect.beyond(setup, hidden, std).any()
    # Parts of the rim beyond the wall that seem a little brighter, and strips within that undo the wall.
    brighter = hidden + np.where(np.arange(hidden.shape[1]) < 2, 0.0, generator(1, "rim").choice([0.0, 0.1, 1.0]))
    assert np.all(np.isfinite(effect.beyond(setup, brighter, std)))
    assert np.flatnonzero(effect.beyond(setup, -0.2 * hidden, std)).tolist() == [0, 1]
    for sign, beyond in ((1, np.inf), (-1, 0.0)):
        unused = np.where(np.arange(hidden.shape[1]) == 1, 0.3, 0.0)[np.newaxis]
        assert effect.beyond(setup, sign * unused, np.where(unused, 0.1, 0.0))[:2].tolist() == [0.0, beyond]


BOXES = Horizon([(0, 90, 0, 8), (30, 60, 0, 8)], [(0, (0, 10, 0, 8)), (0, (90, 100, 0, 8)), (1, (55, 65, 0, 8))])
LIMITS: list[tuple[str, list[float], list[float]]] = [
    ("all hidden, and nothing", [-1, 0, 0, 0, 0], [0, 0, 0, 0, 0]),
    ("less than nothing behind one", [-1.4, 0, 0, 0, 0], [4, 0, 0, 0, 0]),
    ("less than nothing behind both, due to the later", [-1, -0.4, 0, 0, 0], [0, 4, 0, 0, 0]),
    ("a hole in a wall", [-1, 1, 0, 0, 0], [0, 0, 0, 0, 0]),
    ("one that is a little brighter", [-1, 1.1, 0, 0, 0], [0, 1, 0, 0, 0]),
    ("too bright a hole", [-1, 1.5, 0, 0, 0], [0, 5, 0, 0, 0]),
    ("brighter with no wall around it", [0, 0.3, 0, 0, 0], [0, np.inf, 0, 0, 0]),
    ("a strip that undoes the wall", [-1, 0, 1, 0, 0], [0, 0, 0, 0, 0]),
    ("one that does more", [-1, 0, 1.5, 0, 0], [0, 0, 5, 0, 0]),
    ("one of less than nothing", [-1, 0, 0, -3, 0], [0, 0, 0, 20, 0]),
]


@pytest.mark.parametrize(("x", "expected"), [one[1:] for one in LIMITS], ids=[one[0] for one in LIMITS])
def test_a_transmission_is_between_zero_and_one(x: list[float], expected: list[float]) -> None:
    """Errors are 0.1 of each; those of what two boxes hold are larger by the root of two."""
    values = np.array([x], dtype=float)
    found = BOXES.beyond(wide_scene()[0], values, np.where(values, 0.1, 0.0))
    two = np.where(np.isfinite(expected) & (np.arange(5) != 3) & (np.count_nonzero(x) > 1), np.sqrt(2), 1.0)
    np.testing.assert_allclose(found * two, expected, atol=1e-9)


def test_people_are_told_by_how_much_the_transmission_changes() -> None:
    """A wall that hides everything has -1; it is not a transmission of -1."""
    setup = wide_scene()[0]
    told = BOXES.told(setup, np.array([[-1.0, 0, 0, 0, 0]]), np.full((1, 5), 0.1))
    assert told.names[0].startswith("change of transmission at elevation 0-")
    assert told.values[0, 0] == -1.0


def test_what_is_left_out_takes_its_strips_with_it() -> None:
    effect, left = BOXES.without(np.array([True, False, False, False, False]))
    assert effect.describe() == {"walls": [[30, 60, 0, 8]], "strips": [[0, [55, 65, 0, 8]]], "trials": 1}
    assert left.tolist() == [1, 4]
    effect, left = BOXES.without(np.array([False, False, False, True, False]))
    assert left.tolist() == [0, 1, 2, 4]
    assert effect.describe()["strips"] == [[0, [0, 10, 0, 8]], [1, [55, 65, 0, 8]]]


def test_scan_finds_the_wall() -> None:
    setup, block = wide_scene()
    wall = (60.0, 150.0, 6.0)
    truth = Horizon().at(setup, np.array([number_of(*wall)]))
    change = truth.added(block, opaque(truth, setup))
    sigma = 0.1 * float(np.abs(change).max())
    noise = sigma * complex_normal(generator(4, "noise"), change.shape)
    seen = replace(block, residual=change + noise, weights=np.full(block.shape, sigma**-2.0))
    projection, power = Horizon().scan(seen)
    assert projection.shape == power.shape == (Horizon().n_hypotheses(setup), 1)
    drop = np.where(power > 0, 2 * projection**2 / np.where(power > 0, power, 1), 0)[:, 0]
    order = np.argsort(-drop, kind="stable")[:350]
    assert projection[order[0]] < 0
    found = Horizon().at(setup, order)
    assert 1 <= len(found.walls) <= AT_MOST
    first, last, lowest, height = found.walls[0]
    assert lowest == 0
    np.testing.assert_allclose([first, last], wall[:2], atol=15)
    np.testing.assert_allclose(height, wall[2], atol=1)


def test_much_the_same_walls_are_one() -> None:
    setup, _ = wide_scene()
    walls: list[tuple[float, float, float]] = [
        (60, 120, 6),
        (65, 120, 6),
        (60, 120, 5.75),
        (330, 390, 6),
        (60, 180, 6),
        (90, 120, 6),
    ]
    found = Horizon().at(setup, np.array([number_of(*wall) for wall in walls]))
    assert [(first, last, top) for first, last, _, top in found.walls] == [walls[i] for i in (0, 3, 4, 5)]
