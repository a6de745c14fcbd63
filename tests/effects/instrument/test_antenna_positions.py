from dataclasses import replace

import numpy as np

from hydrabeam_mpi.effects.instrument.antenna_positions import AntennaPositions
from hydrabeam_mpi.random import generator
from tests.effects.direct import assert_same, row_vectors, visibilities
from tests.effects.small import check_derivative, small_block, small_setup, with_effect


def test_one_antenna_among_many() -> None:
    """Rows that have not moved keep their groups' integrals."""
    setup = small_setup()
    block = small_block(setup, channel=1)
    effect = AntennaPositions()
    x = np.zeros(21)
    x[6:9] = [0.3, -0.2, 0.1]
    check_derivative(effect, block, x, step=1e-4)
    change = effect.added(block, x)
    touched = (block.ant1 == 2) | (block.ant2 == 2)
    assert not change[:, ~touched].any()
    assert change[:, touched].all()


def test_visibilities_are_those_of_the_moved_array() -> None:
    setup = small_setup()
    effect = AntennaPositions()
    x = effect.draw(setup, generator(2, "positions"), 5.0)
    moved = replace(setup.observation, antpos=setup.observation.antpos + x.reshape(-1, 3))
    for channel in range(2):
        block = small_block(setup, channel)
        block.integrate_for([effect])
        there = replace(block, setup=replace(setup, observation=moved))
        assert_same(visibilities(block), block.vis, block)
        assert_same(with_effect(effect, block, x), visibilities(block, row_vectors(there)), block)


def test_a_common_shift_changes_nothing() -> None:
    setup = small_setup()
    block = small_block(setup)
    effect = AntennaPositions()
    block.integrate_for([effect])
    # A power of two, so that differences cancel to the last digit.
    assert not effect.added(block, np.tile([0.5, 0.25, 0.125], 7)).any()
