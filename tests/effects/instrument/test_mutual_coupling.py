from dataclasses import replace

import numpy as np
import pytest

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.data.redundancy import find_redundant_groups
from hydrabeam_mpi.effects.instrument.mutual_coupling import MutualCoupling, find_shells
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.random import generator
from tests.effects.small import small_block, small_setup

C = 299792458.0


@pytest.fixture(scope="module")
def setup() -> ObservingSetup:
    return small_setup(n_times=3)


@pytest.fixture
def block(setup: ObservingSetup) -> RowBlock:
    return small_block(setup)


def voltages(block: RowBlock, t: int) -> tuple[FloatArray, FloatArray]:
    """Return the response of every antenna to every source, (Nants, Nsrc), and the sources' power."""
    setup = block.setup
    index, za, az = block.positions.above_horizon(t)
    towards = np.stack([np.sin(za) * np.cos(az), np.sin(za) * np.sin(az), np.cos(za)])
    early = setup.observation.antpos @ towards / C
    return np.exp(-2j * np.pi * block.freq * early), 0.5 * setup.sky.flux[block.channel, index] * block.beam(za, az)


def coupled(block: RowBlock, coupling: np.ndarray) -> np.ndarray:
    """Return the change of all visibilities to first order in what the voltages hear of each other, (Ntimes, N, N)."""
    changes = []
    for t in range(len(block.times)):
        v, power = voltages(block, t)
        matrix = (v * power) @ v.conj().T
        changes.append(coupling @ matrix + matrix @ coupling.conj().T)
    return np.array(changes)


def as_measured(block: RowBlock, added: np.ndarray, changes: np.ndarray) -> None:
    """Compare rows with matrices of visibilities, in the sense in which the data have the baselines."""
    observation = block.setup.observation
    numbers = observation.antenna_numbers.tolist()
    added = np.where(block.setup.redundant.flipped[block.bls], added.conj(), added)
    scale = np.abs(changes).max()
    for row, (one, two) in enumerate(observation.antpairs[block.bls].tolist()):
        expected = changes[:, numbers.index(one), numbers.index(two)]
        np.testing.assert_allclose(added[:, row], expected, rtol=0, atol=1e-9 * scale)


def couplings_by_hand(setup: ObservingSetup, freq: float, shells: dict[float, complex]) -> np.ndarray:
    antpos = setup.observation.antpos
    matrix = np.zeros((len(antpos), len(antpos)), dtype=complex)
    for i, here in enumerate(antpos):
        for k, there in enumerate(antpos):
            length = np.linalg.norm(there - here)
            for shell, x in shells.items():
                if abs(length - shell) < 0.01 * shell:
                    matrix[i, k] = x * np.exp(2j * np.pi * freq * length / C)
    return matrix


SHELLS = {14.6: 1e-3 - 2e-3j, 14.6 * 3**0.5: 5e-4 + 1e-3j, 29.2: -7e-4j}
X = np.array([1e-3, -2e-3, 5e-4, 1e-3, 0.0, -7e-4])


def test_known_truth(setup: ObservingSetup, block: RowBlock) -> None:
    """Voltages source by source, coupled pair by pair."""
    effect = MutualCoupling()
    names = effect.parameters(setup).names
    assert names[:4] == tuple(f"coupling at {d} m {part}" for d in ("14.6", "25.3") for part in ("real", "imaginary"))
    assert len(names) == 6
    changes = coupled(block, couplings_by_hand(setup, block.freq, SHELLS))
    as_measured(block, effect.added(block, X), changes)


def test_baselines_that_the_data_lack(setup: ObservingSetup) -> None:
    """Visibilities couple in that no baseline of the data has measured, also where antennas are off their places."""
    rng = generator(2, "positions")
    observation = setup.observation
    antpos = observation.antpos + np.concatenate([rng.uniform(-0.02, 0.02, (7, 2)), np.zeros((7, 1))], axis=1)
    lengths = np.linalg.norm(observation.bl_vectors, axis=1)
    observation = replace(observation, antpos=antpos, antpairs=observation.antpairs[(lengths < 20) | (lengths > 28)])
    fewer = replace(setup, observation=observation, redundant=find_redundant_groups(observation.bl_vectors, 1e-7))
    block = small_block(fewer)
    shells = {14.6: SHELLS[14.6], 25.29: SHELLS[14.6 * 3**0.5], 29.2: SHELLS[29.2]}
    as_measured(block, MutualCoupling().added(block, X), coupled(block, couplings_by_hand(fewer, block.freq, shells)))


def test_groups_within_a_tolerance(setup: ObservingSetup) -> None:
    """Where groups are redundant only nearly so, what couples is what the model has for the group."""
    rng = generator(2, "positions")
    observation = setup.observation
    antpos = observation.antpos + np.concatenate([rng.uniform(-2e-4, 2e-4, (7, 2)), np.zeros((7, 1))], axis=1)
    observation = replace(observation, antpos=antpos)
    redundant = find_redundant_groups(observation.bl_vectors, 0.1)
    assert redundant.Ngroups == setup.redundant.Ngroups
    block = small_block(replace(setup, observation=observation, redundant=redundant))
    changes = coupled(block, couplings_by_hand(block.setup, block.freq, SHELLS))
    added = MutualCoupling().added(block, X)
    numbers = observation.antenna_numbers.tolist()
    one, two = np.array([[numbers.index(n) for n in pair] for pair in observation.antpairs.tolist()]).T
    expected = np.where(redundant.flipped, changes[:, one, two].conj(), changes[:, one, two])
    # Phases are off by 2 pi nu / c times 0.6 mm at most, two of them on each way.
    np.testing.assert_allclose(added, expected, rtol=0, atol=5e-3 * np.abs(expected).max())


def test_scattered_wave_runs_along_with_the_wave(setup: ObservingSetup) -> None:
    """What an antenna scatters reaches those behind it in step with the wave that it comes from."""
    block = small_block(setup)
    matrix = np.array([[0.0, 0.0, 0.0], [14.6, 0.0, 0.0]])
    observation = replace(
        setup.observation,
        antenna_numbers=np.array([0, 1]),
        antenna_names=("0", "1"),
        antpos=matrix,
        antpairs=np.array([[0, 1]]),
    )
    pair = replace(setup, observation=observation, redundant=find_redundant_groups(observation.bl_vectors, 1e-7))

    class East:
        """One source on the eastern horizon: it reaches antenna 1 first."""

        def above_horizon(self, itime: int, below: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            return np.array([0]), np.array([np.pi / 2]), np.array([0.0])

    block = RowBlock(
        setup=pair,
        channel=0,
        times=np.arange(1),
        bls=np.arange(1),
        groups=np.arange(1),
        member=np.zeros(1, dtype=int),
        positions=East(),
        beam=lambda za, az: np.ones_like(za),
    )
    coupling = 0.01 + 0.02j
    flux = 0.5 * setup.sky.flux[0, 0]
    fringe = flux * np.exp(2j * np.pi * block.freq * 14.6 / C)
    # Antenna 0 hears (1 + x) of the wave; antenna 1 hears x of what antenna 0 heard, two ways late.
    late = np.exp(2j * np.pi * block.freq * 2 * 14.6 / C)
    expected = fringe * coupling + fringe * np.conj(coupling * late)
    added = MutualCoupling(1).added(block, np.array([coupling.real, coupling.imag]))
    np.testing.assert_allclose(added[0, 0], expected, rtol=1e-9)


def test_shells() -> None:
    """Distances within two percent are one shell, and there may be fewer than asked for."""
    positions = np.array([[0.0, 0, 0], [10.0, 0, 0], [20.1, 0, 0]])
    shells = find_shells(positions, 3)
    assert [len(distances) for _, _, distances in shells] == [4, 2]
    np.testing.assert_allclose(shells[0][2], [10.0, 10.0, 10.1, 10.1])
