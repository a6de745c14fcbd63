import numpy as np

from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.instrument.closure_errors import ClosureErrors
from tests.effects.small import small_block, small_setup


def test_known_truth() -> None:
    """Factors are those of the data as measured, whichever way round a baseline's group has it."""
    setup = small_setup(n_times=4)
    block = small_block(setup)
    flipped = np.flatnonzero(setup.redundant.flipped)
    bls = np.array([flipped[0], np.flatnonzero(~setup.redundant.flipped)[0]])
    factor = ClosureErrors().at(setup, bls).factor(block, np.array([np.log(0.5), 0.3, np.log(1.2), -0.1]))
    expected = np.ones(block.shape, dtype=complex)
    expected[:, bls[0]], expected[:, bls[1]] = 0.5 * np.exp(0.3j), 1.2 * np.exp(-0.1j)
    np.testing.assert_allclose(np.where(setup.redundant.flipped, factor.conj(), factor), expected, rtol=1e-14)


def test_gains_of_antennas_are_none() -> None:
    """Those of antennas all of whose baselines are meant are left to the effect that is simpler."""
    setup = small_setup(n_times=4)
    block = small_block(setup)
    every = ClosureErrors().at(setup, np.arange(setup.observation.Nbls))
    held = every.degenerate_directions(setup)
    assert len(held) == 2 * setup.observation.Nants - 1  # a phase that all have cancels
    factor = AntennaGains().factor(block, np.linspace(-0.5, 0.4, 2 * setup.observation.Nants))[0]
    as_measured = np.where(setup.redundant.flipped, factor.conj(), factor)
    own = np.stack([np.log(np.abs(factor)), np.angle(as_measured)], axis=1).ravel()
    np.testing.assert_allclose(every.factor(block, own)[0], factor, rtol=1e-12)
    np.testing.assert_allclose(own @ held.T @ held, own, atol=1e-12)
    of_one = ClosureErrors().at(setup, np.flatnonzero(np.any(setup.antenna_index == 2, axis=1)))
    assert len(of_one.degenerate_directions(setup)) == 2
    assert not len(ClosureErrors().at(setup, np.arange(5)).degenerate_directions(setup))
