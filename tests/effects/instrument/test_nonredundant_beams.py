from dataclasses import replace

import numpy as np
import pytest

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.instrument.nonredundant_beams import NonredundantBeams
from hydrabeam_mpi.effects.shared.beam_shapes import MODES
from hydrabeam_mpi.random import generator
from tests.effects.direct import visibilities
from tests.effects.small import small_block, small_setup, with_effect


def gaussian(directions: FloatArray, stretch: FloatArray | None = None) -> FloatArray:
    """An elliptical Gaussian in the plane of radius sin(0.9 za), of which x is stretched by a matrix."""
    east, north, up = directions
    plane = np.stack([east, north]) * (np.sin(0.9 * np.arccos(up)) / np.maximum(np.hypot(east, north), 1e-12))
    if stretch is not None:
        plane = np.linalg.solve(np.eye(2) + stretch, plane)
    return np.exp(-((plane[0] / 0.25) ** 2) - (plane[1] / 0.2) ** 2 - plane[0] * plane[1])


def own_beam(mode: int, amount: float, directions: FloatArray) -> FloatArray:
    """The Gaussian beam changed by one mode."""
    stretch = np.zeros((2, 2))
    if mode < 3:
        stretch[[(0, 0), (1, 1), (0, 1)][mode]] = amount
        if mode == 2:
            stretch[1, 0] = amount
        return gaussian(directions, stretch)
    beam = gaussian(directions)
    weight = [np.ones_like(beam), directions[0], directions[1]][mode - 3]
    return beam + amount * beam * (1 - beam) ** 8 * weight


@pytest.mark.parametrize("mode", range(len(MODES)), ids=MODES)
def test_modes_do_what_they_are_called(mode: int) -> None:
    """Baselines see the mean of their antennas' beams, to first order for the stretches."""
    block = replace(
        small_block(small_setup()),
        beam=lambda za, az: gaussian(np.stack([np.sin(za) * np.cos(az), np.sin(za) * np.sin(az), np.cos(za)])),
    )
    block = replace(block, vis=visibilities(block))
    effect = NonredundantBeams()
    block.integrate_for([effect])
    amounts = 1e-5 * generator(2, "amounts").standard_normal(7)
    x = np.zeros((7, len(MODES)))
    x[:, mode] = amounts

    def beam(directions: FloatArray, row: int) -> FloatArray:
        of_antennas = [own_beam(mode, amounts[ant[row]], directions) for ant in (block.ant1, block.ant2)]
        return 0.5 * (of_antennas[0] + of_antennas[1])

    change = visibilities(block, beam=beam) - block.vis
    found = with_effect(effect, block, x.ravel()) - block.vis
    assert np.abs(change).max() > 0
    np.testing.assert_allclose(found, change, rtol=0, atol=1e-4 * np.abs(change).max())


def test_baselines_have_the_product_of_voltage_beams() -> None:
    """Widths that differ by a tenth, and redundant baselines that no longer agree."""
    block = replace(
        small_block(small_setup()),
        beam=lambda za, az: gaussian(np.stack([np.sin(za) * np.cos(az), np.sin(za) * np.sin(az), np.cos(za)])),
    )
    block = replace(block, vis=visibilities(block))
    amounts = 0.1 * generator(2, "amounts").standard_normal((7, 3))
    amounts[3] = 0
    x = np.concatenate([amounts, np.zeros((7, 3))], axis=1)

    def beam(directions: FloatArray, row: int) -> FloatArray:
        own = []
        for ant in (block.ant1[row], block.ant2[row]):
            east_west, north_south, diagonal = amounts[ant]
            own.append(gaussian(directions, np.array([[east_west, diagonal], [diagonal, north_south]])))
        return np.sqrt(own[0] * own[1])

    found = with_effect(NonredundantBeams(), block, x.ravel())
    expected = visibilities(block, beam=beam)
    assert np.abs(expected - block.vis).max() > 1e-3 * np.abs(block.vis).max()
    # What two antennas share is made from their own positions, not from their group's vector.
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-4 * np.abs(block.vis).max())
