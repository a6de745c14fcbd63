import numpy as np
import pytest

from hydrabeam_mpi.effects.instrument.antenna_delays import AntennaDelays, delays_of
from hydrabeam_mpi.random import complex_normal, generator
from tests.effects.small import matrix_at, small_block, small_setup, with_effect

C = 299792458.0


def test_delay_makes_up_for_the_way_to_the_source() -> None:
    """An antenna nearer to a source by r.s hears it r.s/c early; delayed by as much, all hear it at once."""
    setup = small_setup()
    antpos = setup.observation.antpos
    towards = np.array([0.3, -0.5, np.sqrt(1 - 0.34)])
    order = np.argsort(setup.observation.antenna_numbers)
    index = order[np.searchsorted(setup.observation.antenna_numbers, setup.observation.antpairs, sorter=order)]
    for channel, freq in enumerate(setup.observation.freqs):
        block = small_block(setup, channel)
        path = (antpos[index[:, 1]] - antpos[index[:, 0]]) @ towards
        fringe = np.exp(2j * np.pi * freq * path / C)
        fringe = np.where(setup.redundant.flipped, fringe.conj(), fringe)
        x = (antpos @ towards)[setup.antennas_in_use] / C * 1e9
        # A phase that all have cancels.
        x = np.stack([x, 2e-9 * np.pi * setup.reference_freq * x + 0.7], axis=1).ravel()
        np.testing.assert_allclose(AntennaDelays().factor(block, x) * fringe, np.ones(block.shape), atol=1e-6)


def test_one_law_for_all_channels() -> None:
    """With phases far beyond a turn, several channels together have delays and phases, but for what all share."""
    setup = small_setup(freqs=(131e6, 151e6))
    effect = AntennaDelays()
    row_blocks = [small_block(setup, channel) for channel in range(2)]
    n = len(effect.parameters(setup))
    truth = 20 * generator(4, "delays").standard_normal(n)
    sigma = 0.01 * float(np.abs(row_blocks[0].vis).max())
    rng = generator(5, "delays")
    data = [with_effect(effect, block, truth) + sigma * complex_normal(rng, block.shape) for block in row_blocks]
    x = truth + 0.1 * rng.standard_normal(n)
    for _ in range(6):
        design = np.concatenate([matrix_at(effect, block, x).reshape(-1, n) for block in row_blocks])
        left = np.concatenate(
            [(d - with_effect(effect, s, x)).reshape(-1) for d, s in zip(data, row_blocks, strict=True)]
        )
        fisher = 2 * (design.conj().T @ design).real / sigma**2
        x = x + np.linalg.pinv(fisher, rcond=1e-9) @ (2 * (design.conj().T @ left).real / sigma**2)
    error = (x - truth).reshape(-1, 2)
    error -= error.mean(axis=0)
    assert np.sqrt(error.ravel() @ fisher @ error.ravel() / (n - 2)) < 2.5
    assert np.abs(error).max() < 0.3


@pytest.mark.parametrize("freqs", [140e6 + 2e6 * np.arange(6.0), 1e6 * np.array([120.0, 121.0, 124.0, 131.0, 150.0])])
def test_delays_of_phases_that_are_known_but_for_turns(freqs: np.ndarray) -> None:
    """Up to what channels tell apart; of an antenna that has none they are zero, exactly."""
    setup = small_setup(tuple(freqs), n_times=1)
    n, most = len(setup.antennas_in_use), 0.45e9 / np.diff(freqs).min()
    rng = np.random.default_rng(5)
    delays, at_center = rng.uniform(-most, most, n), rng.uniform(-3, 3, n)
    delays[:3], at_center[:3] = [0.0, 3.0, -7.0], [0.0, 2.7, 3.1]
    phases = 2e-9 * np.pi * np.outer(freqs - setup.reference_freq, delays) + at_center
    found = delays_of(setup, np.angle(np.exp(1j * phases)))
    np.testing.assert_allclose(found[0::2], delays, atol=1e-9 * most)
    np.testing.assert_allclose(np.exp(1j * found[1::2]), np.exp(1j * at_center), atol=1e-9)
    assert not found[:2].any()
