from dataclasses import replace

import numpy as np
import pytest

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.instrument.antenna_pointing import AntennaPointing
from hydrabeam_mpi.random import generator
from tests.effects.direct import assert_same, of_direction, visibilities
from tests.effects.small import small_block, small_setup, with_effect


@pytest.mark.parametrize("towards", [0, 1])
def test_baselines_have_the_product_of_voltage_beams(towards: int) -> None:
    """Plane trigonometry in the vertical plane of the tilt."""
    setup = small_setup()
    block = small_block(setup, channel=1)
    effect = AntennaPointing()
    block.integrate_for([effect])
    tilts = np.array([0.3, 0, -1.2, 0.4, 0.8, 0, 2.0])
    x = np.zeros((7, 2))
    x[:, towards] = tilts
    straight = of_direction(block)

    def tilted(directions: FloatArray, antenna: int) -> FloatArray:
        angle = np.deg2rad(tilts[antenna])
        # The beam tilted one way sees what it would see of a sky turned the other way.
        turned = directions.copy()
        turned[towards] = np.cos(angle) * directions[towards] - np.sin(angle) * directions[2]
        turned[2] = np.cos(angle) * directions[2] + np.sin(angle) * directions[towards]
        return straight(turned)

    def beam(directions: FloatArray, row: int) -> FloatArray:
        one, two = (tilted(directions, ant[row]) for ant in (block.ant1, block.ant2))
        roots = [np.sqrt(np.maximum(power, 0.0)) for power in (one, two)]
        return 0.5 * (one + two) - 0.5 * (roots[0] - roots[1]) ** 2

    assert_same(with_effect(effect, block, x.ravel()), visibilities(block, beam=beam), block)


def test_product_of_voltage_beams_agrees_at_small_tilts() -> None:
    """sqrt(B_i B_j) of Gaussian beams is half their sum to second order in the tilts."""
    block = replace(small_block(small_setup()), beam=lambda za, az: np.exp(-((za / 0.3) ** 2)))
    block = replace(block, vis=visibilities(block))
    effect = AntennaPointing()
    block.integrate_for([effect])
    straight = of_direction(block)
    direction = generator(3, "tilts").standard_normal((7, 2))
    worst = []
    for degrees in (0.05, 0.1):
        tilts = np.deg2rad(degrees) * direction

        def voltage(directions: FloatArray, antenna: int, tilts: FloatArray = tilts) -> FloatArray:
            east, north = tilts[antenna]
            seen = directions - np.array([[east], [north], [0]]) * directions[2]
            seen = seen + np.array([0, 0, 1])[:, np.newaxis] * (east * directions[0] + north * directions[1])
            return np.sqrt(straight(seen / np.linalg.norm(seen, axis=0)))

        def beam(directions: FloatArray, row: int, voltage=voltage) -> FloatArray:
            return voltage(directions, block.ant1[row]) * voltage(directions, block.ant2[row])

        error = with_effect(effect, block, degrees * direction.ravel()) - visibilities(block, beam=beam)
        worst.append(np.abs(error).max())
    change = np.abs(effect.added(block, 0.1 * direction.ravel())).max()
    assert worst[1] < 0.05 * change
    assert 3.5 < worst[1] / worst[0] < 4.5


def test_columns_are_the_derivative_of_the_product_where_antennas_are_tilted() -> None:
    """Of tilted antennas with each other, with straight ones and the other way round, near nulls of beams as well."""
    block = replace(small_block(small_setup()), beam=lambda za, az: np.sinc(za / 0.2) ** 2 + 1e-3)
    effect, step = AntennaPointing(), 1e-4
    block.integrate_for([effect])
    x = np.zeros((7, 2))
    x[[0, 2, 3, 6]] = 2.0 * generator(5, "tilts").standard_normal((4, 2))
    x = x.ravel()
    found = effect.columns(block, x).matrix().toarray()
    for number in range(len(x)):
        more = step * np.eye(len(x))[number]
        slope = (effect.added(block, x + more) - effect.added(block, x - more)) / (2 * step)
        assert np.abs(found[:, number] - slope.ravel()).max() < 1e-5 * np.abs(found).max()
