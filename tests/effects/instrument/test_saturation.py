"""Gains that saturate, and the power that they follow."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hydrabeam_mpi.data.observation import FloatArray, Observation
from hydrabeam_mpi.effects.instrument.saturation import ORDERS, Saturation
from hydrabeam_mpi.io.autos import TIMES_AT_ONCE, median_power
from hydrabeam_mpi.io.uvdata import read_observation
from hydrabeam_mpi.io.uvmeta import Selection
from hydrabeam_mpi.io.uvwrite import write_uvh5
from tests.effects.small import small_block, small_setup

N_TIMES = 12
POWER = 50 + 30 * np.sin(0.4 * np.arange(N_TIMES))


@pytest.mark.parametrize("measured", [True, False])
def test_a_receiver_near_its_limit(measured: bool) -> None:
    """Of one antenna, by the cube of what it measures; of the sky in the model beam where nothing is measured."""
    setup = replace(small_setup(n_times=N_TIMES), measured_power=np.tile(POWER, (2, 1)) if measured else None)
    block, effect = small_block(setup), Saturation()
    assert effect.not_applicable(setup) is None
    x = np.zeros((setup.observation.Nants + 1, ORDERS))
    x[4] = 0.02, 0.01, 0.005
    lost = 1 - effect.factor(block, x.ravel())
    own = (block.ant1 == 3) | (block.ant2 == 3)
    assert np.all(lost[:, ~own] == 0)
    curve = lost[:, own][:, 0]
    np.testing.assert_allclose(lost[:, own].T, np.tile(curve, (np.count_nonzero(own), 1)), atol=1e-15)
    assert np.mean(np.abs(curve) ** 2) == pytest.approx(np.sum(x[4] ** 2))
    if measured:
        cubes = POWER[:, np.newaxis] ** np.arange(1, ORDERS + 1)
        assert np.abs(cubes @ np.linalg.lstsq(cubes, curve)[0] - curve).max() < 1e-12


def test_gains_that_grow_with_the_power_or_vanish_are_no_saturation() -> None:
    """An antenna's loss is that of all and its own; what is not in use is not judged."""
    setup = replace(small_setup(n_times=N_TIMES), measured_power=np.tile(POWER, (2, 1)))
    effect = Saturation().sought_in(setup)
    names = np.array([name.split(",")[0] for name in effect.parameters(setup).names])
    x, std = np.zeros((2, 2, len(names)))

    def judged() -> dict[str, float]:
        return {
            str(name): float(sigma) for name, sigma in zip(names, effect.beyond(setup, x, std), strict=True) if sigma
        }

    def loses(whose: str, loss: float) -> None:
        own = np.flatnonzero(names == whose)
        x[:, own], std[:, own] = [loss, -0.7, 0.3], 0.01

    numbers = setup.observation.antenna_numbers[setup.antennas_in_use].tolist()
    one, two, three, four = (f"antenna {number} beyond that" for number in numbers[:4])
    loses("all antennas", 0.05)
    loses(one, -0.04)
    assert judged() == {}
    loses(two, -0.09)
    loses(three, 1.0)
    assert judged() == {
        two: pytest.approx(0.04 / np.hypot(0.01, 0.01)),
        three: pytest.approx(0.05 / np.hypot(0.01, 0.01)),
    }
    loses("all antennas", -0.1)
    assert set(judged()) == {"all antennas", one, two}
    assert four not in judged()
    rest, left = effect.without(effect.beyond(setup, x, std) > 0)
    assert isinstance(rest, Saturation)
    assert rest.parameters(setup).names == tuple(effect.parameters(setup).names[n] for n in left)
    assert not {"all antennas", one, two} & {name.split(",")[0] for name in rest.parameters(setup).names}
    assert len(rest.degenerate_directions(setup)) == 0
    block = small_block(setup)
    full = np.zeros(len(names))
    full[left] = 0.01 * np.arange(len(left))
    np.testing.assert_array_equal(rest.factor(block, full[left]), effect.factor(block, full))
    np.testing.assert_array_equal(rest.gains(setup, 0, full[left]), effect.gains(setup, 0, full))
    np.testing.assert_array_equal(
        rest.columns(block, full[left]).matrix().toarray(), effect.columns(block, full).matrix().toarray()[:, left]
    )
    again = Saturation(**rest.describe())
    assert again.losses_of == rest.losses_of


def test_what_is_found_is_of_these_data() -> None:
    assert "powers of the data" in str(Saturation().carried_over(small_setup()))


def test_the_power_is_the_median_of_autocorrelations(tmp_path: Path) -> None:
    """Which a dead antenna does not move, and which flagged times do not interrupt."""
    n_times = TIMES_AT_ONCE + 4
    obs = small_setup(n_times=n_times).observation
    autos = np.ones((obs.Nfreqs, n_times, obs.Nants, 1)) * np.linspace(10, 20, n_times)[:, np.newaxis, np.newaxis]
    autos[:, :, 1] = 1e6
    autos[:, 7] = np.nan
    expected = np.tile(np.linspace(10, 20, n_times), (obs.Nfreqs, 1))
    assert_power(tmp_path / "data.uvh5", obs, autos, expected)
    autos[:, : n_times // 2 + 1] = np.nan
    assert_power(tmp_path / "few.uvh5", obs, autos, None)
    assert_power(tmp_path / "constant.uvh5", obs, np.full(autos.shape, 3.0), None)


def assert_power(path: Path, obs: Observation, autos: FloatArray, expected: FloatArray | None) -> None:
    shape = obs.Nfreqs, obs.Ntimes, obs.Nbls, 1
    write_uvh5(path, obs, np.ones(shape, dtype=complex), np.zeros(shape, dtype=bool), np.ones(shape), autos)
    found = median_power([path], read_observation([path], Selection()))
    if expected is None:
        assert found is None
    else:
        np.testing.assert_allclose(found, expected, rtol=1e-6)
