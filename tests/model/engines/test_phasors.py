"""Phasors by table and series against those of NumPy in extended precision."""

import numpy as np
import pytest

from hydrabeam_mpi.model.engines.phasors import AT_ONCE, STEPS, fill_phasors
from hydrabeam_mpi.random import generator


def filled(turns, dtype=np.float64):
    out = np.full((2, *turns.shape), np.nan, dtype)
    fill_phasors(turns, *out)
    return out


@pytest.mark.parametrize("shape", [(0, 5), (5, 0), (1, 1), (7, 1000), (3, AT_ONCE), (2, AT_ONCE + 1)])
def test_they_are_exact(shape):
    turns = generator(0, "turns", shape[0]).uniform(-300, 300, shape)
    angle = 2 * np.longdouble("3.14159265358979323846264338328") * (turns - np.rint(turns)).astype(np.longdouble)
    expected = np.stack([np.cos(angle), np.sin(angle)]).astype(float)
    np.testing.assert_allclose(filled(turns), expected, rtol=0, atol=3e-16)


def test_steps_and_what_is_half_way_between_them():
    turns = np.arange(-2 * STEPS, 2 * STEPS + 1)[np.newaxis] / (2 * STEPS)
    np.testing.assert_allclose(filled(turns)[0], np.cos(2 * np.pi * turns), rtol=0, atol=1e-15)
    quarters = filled(np.array([[0.0, 0.25, 0.5, 0.75, 1.0, -0.25]]))
    np.testing.assert_array_equal(quarters[:, 0], [[1, 0, -1, 0, 1, 0], [0, 1, 0, -1, 0, -1]])


def test_into_parts_of_complex_numbers_and_into_single_precision():
    turns = generator(1, "turns").uniform(-3, 3, (4, 9))
    waves = np.empty(turns.shape, complex)
    fill_phasors(turns, waves.real, waves.imag)
    np.testing.assert_array_equal(np.stack([waves.real, waves.imag]), filled(turns))
    np.testing.assert_array_equal(filled(turns, np.float32), filled(turns).astype(np.float32))
