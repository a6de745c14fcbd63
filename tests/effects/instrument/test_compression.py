from dataclasses import replace

import numpy as np

from hydrabeam_mpi.effects.instrument.compression import Compression
from hydrabeam_mpi.effects.shared.beam_visibilities import beam_visibilities
from hydrabeam_mpi.model.positions import RotatedPositions
from tests.effects.small import small_block, small_setup


def test_gains_fall_with_the_power_that_comes_in() -> None:
    """Of all antennas alike, and of one by more; on average over the times they are as they should be."""
    setup = replace(small_setup(n_times=4), positions=RotatedPositions)
    block = small_block(setup)
    power = beam_visibilities(block, np.zeros((1, 3)))[:, 0].real
    kappa = np.full(setup.observation.Nants, 20.0)
    kappa[3] += 10
    gains = 1 - np.outer(power - power.mean(), kappa) / 1e3
    x = np.append(20.0, 10.0 * (np.arange(setup.observation.Nants) == 3))
    expected = gains[:, block.ant1] * gains[:, block.ant2]
    np.testing.assert_allclose(Compression().factor(block, x), expected, rtol=1e-6)
    assert np.abs(expected - 1).max() > 1e-3
    (held,) = Compression().degenerate_directions(setup)
    np.testing.assert_allclose(Compression().factor(block, 10 * held), 1, rtol=1e-12)
