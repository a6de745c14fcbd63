from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from hydrabeam_mpi.effects.registry import make_effect
from hydrabeam_mpi.effects.shared.displaced import TILTS, BeamToHorizon, angles, rotate, rotation_rate
from hydrabeam_mpi.model.beam import BeamInfo, CoefficientBeam
from hydrabeam_mpi.model.engines.fringes import enu
from hydrabeam_mpi.random import generator
from tests.effects.small import matrix_at, small_block, small_setup


def test_rotations_are_exponentials() -> None:
    rng = generator(1, "rotations")
    vectors = rng.standard_normal((3, 5))
    for rotation in rng.standard_normal((4, 3)):
        cross = np.cross(np.eye(3), rotation)
        np.testing.assert_allclose(rotate(vectors, rotation), expm(cross) @ vectors, atol=1e-14)


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-4, 0.01, 0.5, 3.0])
def test_rates_are_those_of_the_rotation(size: float) -> None:
    rng = generator(2, "rates")
    rotation, step, vector = rng.standard_normal((3, 3))
    rotation *= size
    h = 1e-5
    ahead, behind = (rotate(vector[:, np.newaxis], rotation + sign * h * step)[:, 0] for sign in (1, -1))
    rate = np.cross(rotation_rate(rotation) @ step, rotate(vector[:, np.newaxis], rotation)[:, 0])
    np.testing.assert_allclose(rate, (ahead - behind) / (2 * h), atol=1e-9)


def test_tilts_take_the_zenith_where_they_say() -> None:
    zenith = np.array([[0.0], [0.0], [1.0]])
    for tilt, where in zip(TILTS.T, np.eye(3), strict=False):
        np.testing.assert_allclose(rotate(zenith, 0.1 * tilt)[:, 0], np.cos(0.1) * zenith[:, 0] + np.sin(0.1) * where)


def test_angles_invert_unit_vectors() -> None:
    za, az = np.array([0.1, 1.0, 2.0]), np.array([0.2, 3.0, 6.0])
    np.testing.assert_allclose(angles(enu(za, az)), (za, az))


def test_beams_end_at_the_horizon() -> None:
    beam = BeamToHorizon(lambda za, az: np.cos(za) + za)
    np.testing.assert_allclose(beam(np.array([1.0, 1.7, 2.5]), np.zeros(3)), [np.cos(1) + 1, np.pi / 2, np.pi / 2])


@pytest.mark.parametrize("kind", ["antenna_pointing", "nonredundant_beams", "timestamp"])
def test_a_beam_by_its_table_is_seen_as_the_beam_itself(kind: str) -> None:
    """What an effect adds, and its columns."""
    setup = small_setup()
    exact = small_block(setup)
    info = BeamInfo("fitted", exact.freq, "ee")
    tabulated = replace(exact, beam=CoefficientBeam(setup.basis, setup.prior_mean[0], info))
    effect = make_effect(kind, {})
    x = effect.draw(setup, generator(2, "tilts"), 1.0)
    for at in (np.zeros_like(x), x):
        for block in (tabulated, exact):
            block.integrate_for([effect])
        for seen in (effect.added, lambda block, at: matrix_at(effect, block, at)):
            one, two = seen(tabulated, at), seen(exact, at)
            np.testing.assert_allclose(one, two, rtol=0, atol=2e-7 * np.abs(two).max())
