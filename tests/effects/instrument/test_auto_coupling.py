from dataclasses import replace

import numpy as np
import pytest

from hydrabeam_mpi.effects.instrument.auto_coupling import AutoCoupling
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.shared.beam_visibilities import beam_visibilities
from hydrabeam_mpi.random import complex_normal, generator
from tests.effects.small import small_block, small_setup


@pytest.fixture(scope="module")
def setup() -> ObservingSetup:
    return small_setup(n_times=4)


@pytest.fixture
def block(setup: ObservingSetup) -> RowBlock:
    return small_block(setup)


def test_known_truth(setup: ObservingSetup, block: RowBlock) -> None:
    """Voltages that hear a fraction of each other, with autocorrelations summed source by source."""
    observation = setup.observation
    numbers = observation.antenna_numbers.tolist()
    eps = 1e-3 * complex_normal(generator(3, "eps"), (7, 7))  # of i's voltage in j
    autos = np.zeros(observation.Ntimes)
    for t in range(observation.Ntimes):
        index, za, az = block.positions.above_horizon(t)
        power = setup.basis.synthesize(setup.prior_mean[0], za, az).real
        autos[t] = 0.5 * sum(flux * p for flux, p in zip(setup.sky.flux[0, index], power, strict=True))
    assert autos.max() > 1.2 * autos.min()

    effect = AutoCoupling(observation.antpairs.tolist())
    x = []
    for one, two in observation.antpairs.tolist():
        i, j = numbers.index(one), numbers.index(two)
        amplitude = np.conj(eps[i, j]) + eps[j, i]
        x += [amplitude.real, amplitude.imag]
    added = effect.added(block, np.array(x))
    added = np.where(setup.redundant.flipped, added.conj(), added)
    for bl, (one, two) in enumerate(observation.antpairs.tolist()):
        i, j = numbers.index(one), numbers.index(two)
        np.testing.assert_allclose(added[:, bl], np.conj(eps[i, j]) * autos + eps[j, i] * autos, rtol=1e-10)


def test_autocorrelations_follow_the_beam(block: RowBlock) -> None:
    """They are integrated once, and again for another beam or other times."""
    zero = np.zeros((1, 3))
    first = beam_visibilities(block, zero)
    assert beam_visibilities(block, zero) is first
    np.testing.assert_array_equal(beam_visibilities(replace(block, times=block.times[1:3]), zero), first[1:3])
    old = block.beam
    block = replace(block, beam=lambda za, az: 2 * old(za, az))
    np.testing.assert_allclose(beam_visibilities(block, zero), 2 * first, rtol=1e-12)
    assert beam_visibilities(replace(block, times=block.times[:0]), zero).shape == (0, 1)
