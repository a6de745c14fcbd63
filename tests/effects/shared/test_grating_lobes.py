from dataclasses import replace

import numpy as np
import pytest

from hydrabeam_mpi.data.observation import C_M_PER_S
from hydrabeam_mpi.data.redundancy import find_redundant_groups
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.shared.grating_lobes import grating_lobes, seen_alike, turns_of_sky
from hydrabeam_mpi.effects.sky.missing_sources import candidates
from hydrabeam_mpi.effects.sky.moving_sources import MovingSources
from hydrabeam_mpi.model.engines.fringes import enu
from hydrabeam_mpi.model.positions import RotatedPositions
from hydrabeam_mpi.model.sky import Sky
from tests.effects.small import small_block, small_setup


@pytest.fixture(scope="module")
def setup() -> ObservingSetup:
    """Seven antennas in a hexagon, 14.6 m apart, in three of thirteen times in six hours."""
    made = small_setup((150e6,), n_times=13)
    return replace(made, positions=RotatedPositions, times=np.array([5, 6, 7]))


def test_fringes_are_alike_in_all_lobes(setup: ObservingSetup) -> None:
    lobes = grating_lobes(setup)
    vectors = setup.redundant.vectors[:, :2]
    np.testing.assert_allclose(np.exp(2j * np.pi * 150e6 / C_M_PER_S * vectors @ lobes.T), 1, atol=1e-9)
    # Those of a hexagon are as far as wavelengths in the distance of its rows.
    nearest = np.sort(np.hypot(*lobes.T))[:6]
    np.testing.assert_allclose(nearest, C_M_PER_S / 150e6 / (14.6 * np.sqrt(3) / 2), rtol=1e-6)


def test_an_array_that_is_on_no_lattice_has_none(setup: ObservingSetup) -> None:
    moved = setup.redundant.vectors + np.random.default_rng(1).normal(size=setup.redundant.vectors.shape)
    scattered = replace(setup, redundant=find_redundant_groups(moved, 1e-7))
    assert grating_lobes(scattered).shape == (0, 2)


def test_places_are_where_the_lobes_are(setup: ObservingSetup) -> None:
    at = np.array([setup.observation.lsts[6] + 0.1, setup.observation.latitude + 0.05])
    (turn,) = turns_of_sky(setup, np.array([6]))
    places, za = seen_alike(turn, at, grating_lobes(setup))
    up = np.isfinite(za)
    assert up.sum() > 6
    assert np.all(np.isnan(places[~up]))
    index, own_za, own_az = RotatedPositions(
        Sky(*np.append(places[up], [at], axis=0).T, np.ones((1, up.sum() + 1))), setup.observation
    ).above_horizon(6)
    directions = enu(own_za, own_az)[:, np.argsort(index)]
    apart = directions[:2, :-1].T - directions[:2, -1]
    np.testing.assert_allclose(apart, grating_lobes(setup)[up], atol=1e-9)
    np.testing.assert_allclose(np.arccos(directions[2, :-1]), za[up], atol=1e-7)


def test_a_source_that_moves_is_seen_alike_where_its_lobes_move(setup: ObservingSetup) -> None:
    ra, dec = candidates(setup, np.deg2rad(70.0))
    effect = MovingSources(np.rad2deg([[ra[3], dec[3]], [ra[9], dec[9]]]).tolist()).in_full(setup)
    x = np.array([[1.0, 0.1, -0.2, 0.5, -1.0, 2.0, 0.0, 0.0, 0.0, 0.0]])
    found = list(effect.alike(setup, x, 0))
    assert len(found) >= 6
    block = small_block(setup)
    own = effect.seen(block, x[0])[5:8, :, 0]
    for other in found[:6]:
        assert other.sources[1] == effect.sources[1]
        seen = other.seen(block, np.zeros(10))[5:8, :, 0]
        alike = np.abs(np.sum(own.conj() * seen, axis=1)) / np.sqrt(
            np.sum(np.abs(own) ** 2, axis=1) * np.sum(np.abs(seen) ** 2, axis=1)
        )
        assert alike.min() > 0.9
