from dataclasses import replace

import numpy as np
import pytest

from hydrabeam_mpi.effects.instrument.cable_reflections import CableReflections, candidate_delays
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.random import complex_normal, generator
from tests.effects.small import matrix_at, small_block, small_setup, with_effect

FREQS = tuple(float(freq) for freq in 140e6 + 1e6 * np.arange(6))


@pytest.fixture(scope="module")
def setup() -> ObservingSetup:
    return small_setup(freqs=FREQS, n_times=4)


@pytest.fixture
def block(setup: ObservingSetup) -> RowBlock:
    return small_block(setup, channel=1)


def test_known_truth(setup: ObservingSetup) -> None:
    """The voltage of an echo: A of it again, tau later, turned by phi."""
    numbers = setup.observation.antenna_numbers.tolist()
    strength, tau, phi = 0.25, 333e-9, 0.7
    middle = float(np.mean(FREQS))
    z = strength * np.exp(1j * (2 * np.pi * middle * tau + phi))
    effect = CableReflections([(numbers[3], 330.0)])
    for channel, freq in enumerate(FREQS):
        block = small_block(setup, channel)
        factor = effect.factor(block, np.array([z.real, z.imag, 3.0]))
        for bl, (one, two) in enumerate(setup.observation.antpairs.tolist()):
            gains = [1 + strength * np.exp(2j * np.pi * freq * tau + 1j * phi) * (n == numbers[3]) for n in (one, two)]
            expected = gains[0] * np.conj(gains[1])
            got = factor[0, bl].conj() if setup.redundant.flipped[bl] else factor[0, bl]
            np.testing.assert_allclose(got, expected, rtol=1e-9)


def test_candidates_are_told_apart(setup: ObservingSetup) -> None:
    """Delays begin at 1/bandwidth, are told apart by the channels, and early ones differ from late ones."""
    delays = candidate_delays(setup)
    resolution = 1e9 / 6e6
    np.testing.assert_allclose(delays, resolution / 2 * np.array([-5, -4, -3, -2, 2, 3, 4, 5, 6]))
    waves = np.exp(2j * np.pi * np.outer(np.array(FREQS), delays * 1e-9))
    overlap = np.abs(waves.conj().T @ waves) / len(FREQS) - np.eye(len(delays))
    assert overlap.max() < 0.7
    assert CableReflections().n_hypotheses(setup) == 7 * 9
    three = replace(setup, observation=replace(setup.observation, freqs=np.array(FREQS[:3])))
    assert CableReflections().n_hypotheses(three) == 0


def test_candidates_of_uneven_channels(setup: ObservingSetup) -> None:
    freqs = np.array([140e6, 140.5e6, 143e6, 144e6, 149.5e6])
    uneven = replace(setup, observation=replace(setup.observation, freqs=freqs))
    delays = candidate_delays(uneven)
    np.testing.assert_allclose(delays.max(), 1000.0)
    np.testing.assert_allclose(np.abs(delays).min(), 100.0)
    assert len(delays) == 37


def test_one_antenna_does_not_fill_all_places() -> None:
    """Of each antenna the candidates that come first are kept, in their order."""
    wide, delays, numbers = wide_band(60)
    hypotheses = np.concatenate([5 + 3 * np.arange(20), len(delays) + 3 * np.arange(3)])
    first = [(numbers[0], delay) for delay in delays[hypotheses[:20]]]
    second = [(numbers[1], delay) for delay in delays[3 * np.arange(3)]]
    assert CableReflections().at(wide, hypotheses).reflections == (*first[:16], *second)
    assert CableReflections().at(wide, hypotheses[::-1]).reflections == (*second[::-1], *first[::-1][:16])


def test_echoes_beside_a_better_one_are_left_out() -> None:
    wide, delays, numbers = wide_band(60)
    n = len(delays)
    kept = CableReflections().at(wide, np.array([10, 11, 12, 13, 8, 7, n + 11])).reflections
    assert kept == (
        (numbers[0], delays[10]),
        (numbers[0], delays[13]),
        (numbers[0], delays[7]),
        (numbers[1], delays[11]),
    )


def wide_band(n_freqs: int) -> tuple[ObservingSetup, np.ndarray, list[int]]:
    """Return an experiment with many channels, the delays that are scanned, and the antennas' numbers."""
    wide = small_setup(n_times=1)
    wide = replace(wide, observation=replace(wide.observation, freqs=140e6 + 1e6 * np.arange(n_freqs)))
    return wide, candidate_delays(wide), wide.observation.antenna_numbers.tolist()


def gauss_newton(
    effect: Effect, row_blocks: list[RowBlock], data: list[np.ndarray], sigma: float
) -> tuple[np.ndarray, ...]:
    """Fit parameters that all channels share, linear ones first, as delays have no derivative without amplitudes."""
    parameters = effect.parameters(row_blocks[0].setup)
    n = len(parameters)
    x = np.zeros(n)
    for step in range(15):
        free = np.flatnonzero(~parameters.nonlinear) if step == 0 else np.arange(n)
        design = np.concatenate([matrix_at(effect, block, x).reshape(-1, n) for block in row_blocks])[:, free]
        left = np.concatenate(
            [(d - with_effect(effect, s, x)).reshape(-1) for d, s in zip(data, row_blocks, strict=True)]
        )
        fisher = 2 * (design.conj().T @ design).real / sigma**2
        change = np.linalg.solve(fisher, 2 * (design.conj().T @ left).real / sigma**2)
        x[free] += change
    assert np.all(np.abs(change) < 1e-3 / np.sqrt(np.diag(fisher)))
    return x, fisher


def test_scan_finds_and_fit_refines(setup: ObservingSetup) -> None:
    """An echo between the candidates is found next to where it is and fitted within its error."""
    numbers = setup.observation.antenna_numbers.tolist()
    row_blocks = [small_block(setup, channel) for channel in range(len(FREQS))]
    sigma = 0.02 * float(np.abs(row_blocks[0].vis).max())
    rng = generator(3, "echo")
    truth = np.array([0.02, -0.05, 8.0])
    echo = CableReflections([(numbers[4], -215.0)])
    data = [with_effect(echo, block, truth) + sigma * complex_normal(rng, block.shape) for block in row_blocks]
    for block, rows in zip(row_blocks, data, strict=True):
        block.residual[:], block.weights[:] = rows - block.vis, np.full(block.shape, sigma**-2)
    sums, norms = (
        np.sum(parts, axis=0) for parts in zip(*(CableReflections().scan(s) for s in row_blocks), strict=True)
    )
    gain = np.sum(sums**2 / norms, axis=1)
    found = CableReflections().at(setup, np.array([gain.argmax()]))
    number, delay = found.reflections[0]
    assert number == numbers[4]
    assert abs(delay + 207.0) < 1e9 / 6e6 / 2

    x, fisher = gauss_newton(found, row_blocks, data, sigma)
    error = x - np.array([0.02, -0.05, -207.0 - delay])
    assert error @ fisher @ error < 16.3  # 99.9% of chi^2 with 3 degrees of freedom
    assert abs(error[2]) < 20


def test_unknown_antenna(setup: ObservingSetup) -> None:
    with pytest.raises(InputError, match="no baseline has antenna 99"):
        CableReflections([(99, 200.0)]).parameters(setup)


def test_an_echo_is_told_by_amplitude_phase_and_one_delay(setup: ObservingSetup) -> None:
    """With the errors of a complex number's size and angle; what is not used is left behind."""
    numbers = setup.observation.antenna_numbers.tolist()
    echo = CableReflections([(numbers[1], 200.0), (numbers[2], -300.0)])
    x = np.tile([0.01, 0.02, 1.0, 0.03, -0.04, 7.5], (6, 1))
    std = np.tile([0.1, 0.1, 2.0, 0.001, 0.002, 1.5], (6, 1))
    refined, left, kept = echo.refined(x, np.array([3, 4, 5]))
    assert refined.reflections == ((numbers[2], -292.5),)
    np.testing.assert_array_equal(left[0], [0.03, -0.04, 0.0])
    assert kept.tolist() == [3, 4, 5]
    for effect, at in ((echo, x), (refined, left)):
        told = effect.told(setup, at, std[:, -at.shape[1] :])
        name = f"antenna {numbers[2]} reflection at -292.5 ns"
        assert told.names[-3:] == tuple(f"{name}: {what}" for what in ("amplitude", "phase", "delay"))
        assert told.units[-3:] == ("", "rad", "ns")
        np.testing.assert_allclose(told.values[2, -3:], [0.05, np.arctan2(-4, 3), -292.5])
        along, aside = np.hypot(0.6 * 0.001, 0.8 * 0.002), np.hypot(0.8 * 0.001, 0.6 * 0.002)
        np.testing.assert_allclose(told.std[2, -3:], [along, aside / 0.05, 1.5])
        assert told.from_zero[-3:].tolist() == [True, False, False]
    block = small_block(setup, channel=1)
    np.testing.assert_allclose(
        refined.factor(block, left[0]), CableReflections(echo.reflections[1:]).factor(block, x[0, 3:])
    )
