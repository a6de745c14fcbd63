import numpy as np
import pytest

from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.instrument.closure_errors import ClosureErrors
from hydrabeam_mpi.effects.shared.per_antenna import LARGEST_LN
from hydrabeam_mpi.random import generator
from tests.effects.small import small_block, small_setup


def test_flipped_baselines_are_conjugated() -> None:
    """The gains that multiply V_jk as g_j g_k* multiply the group's V_kj as g_k g_j*."""
    setup = small_setup()
    block = small_block(setup)
    x = AntennaGains().draw(setup, generator(2, "gains"), 0.3)
    gains = np.exp(x[0::2] + 1j * x[1::2])
    numbers = setup.observation.antenna_numbers.tolist()
    first, second = (gains[[numbers.index(number) for number in column]] for column in setup.observation.antpairs.T)
    factor = AntennaGains().factor(block, x)[0]
    flipped = setup.redundant.flipped
    np.testing.assert_allclose(np.where(flipped, factor.conj(), factor), first * second.conj(), rtol=1e-12)


def test_gains_beyond_reason_stay_within_a_double() -> None:
    setup = small_setup()
    factor = AntennaGains().factor(small_block(setup), np.full(2 * len(setup.antennas_in_use), 1e30))
    assert np.all(np.isfinite(np.abs(factor) ** 2))


def test_a_fit_of_a_lost_sign_begins_with_its_phase() -> None:
    """The columns at zero find g - 1 = -2; of an antenna without signal, -1, the logarithm is large and finite."""
    x = np.array([-2.0, 0.0, 1e-9, -2e-9, -1.0, 0.0, 0.0, 0.0])
    begun = AntennaGains().begun(small_setup(), x)
    np.testing.assert_allclose(begun[:4], [0.0, np.pi, 1e-9, -2e-9], atol=1e-15)
    assert -LARGEST_LN <= begun[4] < -10
    assert not begun[6:].any()


@pytest.mark.parametrize("kind", [AntennaGains, ClosureErrors])
def test_a_lost_sign_needs_a_phase_that_was_not_looked_for(kind: type[AntennaGains] | type[ClosureErrors]) -> None:
    """In any of the channels; where there is a phase already, or the sign stays, none is needed."""
    x = np.array([[0.0, 0.0, -0.9, 0.0, -2.0, 0.1, 0.3, 0.0], [-1.1, 0.0, 0.0, 0.0, -2.0, 0.0, 0.0, 0.0]])
    effect = kind()
    same, own, needed = effect.needed_at(small_setup(), x)
    assert same is effect
    np.testing.assert_array_equal(own, np.arange(8))
    np.testing.assert_array_equal(np.flatnonzero(needed), [1])
