import numpy as np
import pytest

from hydrabeam_mpi.effects.instrument.cross_coupling import CrossCoupling
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.errors import InputError
from tests.effects.small import small_block, small_setup


@pytest.fixture(scope="module")
def setup() -> ObservingSetup:
    return small_setup(n_times=4)


@pytest.fixture
def block(setup: ObservingSetup) -> RowBlock:
    return small_block(setup)


def test_known_truth(setup: ObservingSetup, block: RowBlock) -> None:
    """Parameters are those of the data as measured, whichever way round a baseline's group has it."""
    flipped = np.flatnonzero(setup.redundant.flipped)
    assert len(flipped)
    bls = np.array([flipped[0], np.flatnonzero(~setup.redundant.flipped)[0]])
    effect = CrossCoupling().at(setup, bls)
    excess = np.zeros(block.shape, dtype=complex)
    excess[:, bls[0]], excess[:, bls[1]] = 3 - 4j, 5 + 6j
    added = effect.added(block, np.array([3.0, -4.0, 5.0, 6.0]))
    np.testing.assert_array_equal(np.where(setup.redundant.flipped, added.conj(), added), excess)
    one, two = setup.observation.antpairs[bls[0]]
    names = effect.parameters(setup).names
    assert names[:2] == (f"baseline {one}-{two} real", f"baseline {one}-{two} imaginary")


def test_baselines_in_either_order(setup: ObservingSetup) -> None:
    one, two = setup.observation.antpairs[5].tolist()
    names = [CrossCoupling([pair]).parameters(setup).names for pair in ((one, two), (two, one))]
    assert names[0] == names[1]


def test_wrong_baselines(setup: ObservingSetup) -> None:
    one, two = setup.observation.antpairs[5].tolist()
    with pytest.raises(InputError, match="no baseline 3-99"):
        CrossCoupling([(3, 99)]).parameters(setup)
    with pytest.raises(InputError, match="named twice"):
        CrossCoupling([(one, two), (two, one)]).parameters(setup)
