from dataclasses import replace

import numpy as np

from hydrabeam_mpi.data.observation import EARTH_RATE
from hydrabeam_mpi.effects.instrument.timestamp import Timestamp
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.model.positions import ApparentPositions, RotatedPositions
from tests.effects.direct import assert_same, visibilities
from tests.effects.small import small_block, small_setup, with_effect


def up(block: RowBlock, itime: int) -> list[int]:
    return block.positions.above_horizon(itime)[0].tolist()


def test_visibilities_are_those_of_later_times() -> None:
    """Sources where a sidereal clock that is ahead puts them, with those that rise and without those that set."""
    setup = small_setup(n_sources=2000)
    block = small_block(setup)
    effect = Timestamp()
    block.integrate_for([effect])
    for seconds in (100.0, -200.0):
        observation = replace(setup.observation, lsts=setup.observation.lsts + EARTH_RATE * seconds)
        later = replace(block, positions=RotatedPositions(setup.sky, observation))
        changes = [(set(up(later, t)) - set(up(block, t)), set(up(block, t)) - set(up(later, t))) for t in block.times]
        assert all(any(kind) for kind in zip(*changes, strict=True))
        assert_same(with_effect(effect, block, np.array([seconds])), visibilities(later), block)


def test_apparent_places_turn_alike() -> None:
    """Astropy's places half a minute later, to within what precession and polar motion change of the axis."""
    setup = small_setup()
    observation = setup.observation
    block = replace(small_block(setup), positions=ApparentPositions(setup.sky, observation))
    block = replace(block, vis=visibilities(block))
    effect = Timestamp()
    block.integrate_for([effect])
    later = replace(observation, times=observation.times + 30.0 / 86400)
    scene_later = replace(block, positions=ApparentPositions(setup.sky, later))
    truth = visibilities(scene_later)
    change = np.abs(truth - block.vis).max()
    np.testing.assert_allclose(with_effect(effect, block, np.array([30.0])), truth, rtol=0, atol=1e-4 * change)


def test_places_that_are_kept_are_not_mistaken_for_turned_ones() -> None:
    block = small_block(small_setup())
    effect = Timestamp()
    block.integrate_for([effect])
    change = effect.added(block, np.array([60.0]))
    block = replace(block, places={}, integrals={})
    block.integrate_for([effect])
    assert len(block.places) == len(block.times)
    assert_same(effect.added(block, np.array([60.0])), change, block, rtol=1e-12)
    assert_same(block.spread(block.integrals[effect.integrated_as])[..., 0], block.vis, block)
