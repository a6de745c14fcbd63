from dataclasses import replace

import numpy as np
import pytest

from hydrabeam_mpi.effects.instrument.ground_emitter import GroundEmitter
from hydrabeam_mpi.effects.shared.grating_lobes import grating_lobes
from hydrabeam_mpi.effects.shared.point_sources import resolution
from tests.effects.direct import C, row_vectors
from tests.effects.small import small_block, small_setup


def test_known_truth_is_found_by_a_scan_and_told() -> None:
    """A plane wave along the ground, from between two candidates."""
    setup = small_setup(n_times=4)
    block = small_block(setup)
    azimuth = np.deg2rad(123.4)
    towards = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    wave = 2.5 * np.exp(2j * np.pi * block.freq / C * (row_vectors(block) @ towards))
    emitter = GroundEmitter([123.0])
    x = np.array([2.5, 0.4])
    np.testing.assert_allclose(emitter.added(block, x), np.tile(wave, (4, 1)), rtol=1e-9)
    told = emitter.told(setup, x[np.newaxis], np.full((1, 2), 0.1))
    assert told.names == ("emitter at azimuth 123.00 deg: power", "emitter at azimuth 123.00 deg: azimuth")
    np.testing.assert_allclose(told.values, [[2.5, 123.4]])
    sums, norms = GroundEmitter().scan(replace(block, residual=np.tile(wave, (4, 1))))
    found = GroundEmitter().at(setup, np.argsort(-sums[:, 0] / norms[:, 0]))
    # A lattice of antennas hears other directions nearly alike.
    assert min(abs(one - 123.4) for one in found.azimuths[:5]) <= np.rad2deg(resolution(setup)) / 5
    assert len(found.azimuths) == 10


def test_powers_below_zero_are_none() -> None:
    emitter = GroundEmitter([10.0, 200.0])
    beyond = emitter.beyond(small_setup(), np.array([[1.0, 0.1, -0.3, 0.2]]), np.full((1, 4), 0.1))
    np.testing.assert_allclose(beyond, [0, 0, 3, 0])
    left, numbers = emitter.without(beyond > 2)
    assert left.azimuths == (10.0,)
    assert numbers.tolist() == [0, 1]


def test_lobes_on_the_horizon_are_seen_alike() -> None:
    """Of a direction s and a lobe d with |s + d| = 1 the fringes are the same."""
    setup = small_setup()
    block = small_block(setup)
    lobe = grating_lobes(setup)[0]
    azimuth = float(np.rad2deg(np.arctan2(*lobe[::-1]) + np.arccos(-np.hypot(*lobe) / 2))) % 360
    towards = np.array([np.cos(np.deg2rad(azimuth)), np.sin(np.deg2rad(azimuth))]) + lobe
    other = float(np.rad2deg(np.arctan2(towards[1], towards[0]))) % 360
    one, x = GroundEmitter([azimuth - 0.3, 10.0]), np.array([[2.0, 0.3, 1.0, 0.0]])
    first = next(iter(one.alike(setup, x, 0)))
    assert first.azimuths == pytest.approx((other, 10.0))
    turns = setup.reference_freq / C * (row_vectors(block)[:, :2] @ lobe)
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-3)
