"""Smearing as an effect, against the engine's means and against means of visibilities at many instants."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydrabeam_mpi.data.observation import EARTH_RATE
from hydrabeam_mpi.effects.instrument.smearing import Smearing
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.model.positions import RotatedPositions
from tests.effects.direct import visibilities
from tests.effects.small import small_block, small_setup, with_effect

SECONDS, MHZ = 200.0, 2.0
LONG = 3600.0
"""Seconds in which fringes turn by more than half a turn, for which there is an instant in the very middle."""


def setup_and_block() -> tuple[ObservingSetup, RowBlock]:
    setup = small_setup(n_sources=300)
    return setup, small_block(setup)


def even() -> tuple[ObservingSetup, RowBlock]:
    """One time, with sources that are high, in a beam of one."""
    setup, block = setup_and_block()
    index, za, _ = block.positions.above_horizon(0)
    flux = np.zeros_like(setup.sky.flux)
    flux[:, index[za < np.deg2rad(80)]] = 1.0
    setup = replace(setup, sky=replace(setup.sky, flux=flux), times=np.array([0]))
    alone = replace(block, setup=setup, times=block.times[:1], beam=lambda za, az: np.ones_like(za))
    return setup, replace(alone, vis=visibilities(alone), integrals={})


@pytest.mark.parametrize("length", [(SECONDS, 0.0), (0.0, MHZ), (SECONDS, MHZ)])
def test_it_is_what_the_engine_has(length: tuple[float, float]) -> None:
    """To what rates that change within an integration make of it, and one mean of the other.

    In a beam that is the same for all, of sources that do not set.
    """
    setup, block = even()
    effect = Smearing()
    block.integrate_for([effect])
    observation = replace(
        setup.observation,
        integration_time=np.full(6, length[0]),
        channel_width=np.full(2, length[1] * 1e6),
        is_smeared=True,
    )
    assert "already" in str(effect.not_applicable(replace(setup, observation=observation)))
    smeared = replace(block, setup=replace(setup, observation=observation), integrals={})
    wanted = block.spread(smeared.integrate(lambda sources: sources.beam[np.newaxis])[..., 0])
    lost = np.abs(wanted - block.vis).max()
    found = with_effect(effect, block, np.square(length))
    assert lost > 1e-4 * np.abs(block.vis).max()
    np.testing.assert_allclose(found, wanted, rtol=0, atol=0.05 * lost)


@pytest.mark.parametrize("seconds", [SECONDS, LONG])
def test_it_is_the_mean_over_instants(seconds: float) -> None:
    """Through the beam; sources that rise or set meanwhile are there at some of the instants."""
    setup, block = setup_and_block()
    first = replace(block, times=block.times[:1], vis=block.vis[:1], weights=block.weights[:1])
    effect = Smearing(("time",))
    first.integrate_for([effect])
    mean = 0.0
    steps = (np.arange(200) + 0.5) / 200 - 0.5
    for step in steps:
        turned = replace(setup.observation, lsts=setup.observation.lsts + EARTH_RATE * seconds * step)
        mean = mean + visibilities(replace(first, positions=RotatedPositions(setup.sky, turned))) / len(steps)
    now = visibilities(first)
    np.testing.assert_allclose(
        now + effect.added(first, np.array([seconds**2])), mean, rtol=0, atol=5e-3 * np.abs(mean - now).max()
    )


def test_lengths_are_told_and_are_not_negative() -> None:
    setup, _ = setup_and_block()
    effect = Smearing()
    x, std = np.array([[900.0, -0.04]] * 2), np.array([[6.0, 0.01]] * 2)
    told = effect.told(setup, x, std)
    assert told.names == ("integrations are means over", "channels are means over")
    assert told.units == ("s", "MHz")
    np.testing.assert_allclose(told.values[0], [30.0, -0.2])
    np.testing.assert_allclose(told.std[0], [0.1, 0.025])
    np.testing.assert_allclose(effect.told(setup, 0 * x, std).std[0], np.sqrt([6.0, 0.01]))
    np.testing.assert_allclose(effect.beyond(setup, x, std), [0.0, 4.0])
    left, numbers = effect.without(np.array([False, True]))
    assert left == Smearing(("time",))
    assert numbers.tolist() == [0]
    assert np.all(effect.draw(setup, np.random.default_rng(0), 1.0) > 0)
