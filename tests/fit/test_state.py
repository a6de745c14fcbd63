"""Where a fit of effects begins, and what of them is free."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hydrabeam_mpi.effects.instrument.antenna_delays import AntennaDelays
from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.sky.missing_sources import MissingSources
from hydrabeam_mpi.fit.blocks import BeamBlock
from hydrabeam_mpi.fit.state import Active, Estimate, Values
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.io.kept_rounds import read_object, write_object
from hydrabeam_mpi.random import generator
from tests.effects.small import small_setup

EXPERIMENT = small_setup(n_times=2)
N_ANTENNAS = len(EXPERIMENT.antennas_in_use)


def test_elements_in_use_bring_what_is_refined_of_them() -> None:
    """With a prior of three natural sizes, and steps of one at most."""
    sources = MissingSources([(10.0, -30.0), (40.0, -25.0)])
    parameters = sources.parameters(EXPERIMENT)
    flux = np.where(np.arange(8) == 4, 2.0, 0.0)  # of the second source
    found = Active.start(sources, EXPERIMENT, flux, 1.5 * (flux > 0))
    assert found.used.tolist() == [4, 5, 6, 7]
    np.testing.assert_allclose(found.prior.of(0).std() ** 2, [2.0, *(9 * parameters.scale[5:] ** 2)])
    np.testing.assert_array_equal(found.step_limit, np.where(parameters.nonlinear, parameters.scale, np.inf))
    np.testing.assert_array_equal(found.x, [[0, 0, 0, 0, 1.5, 0, 0, 0]] * 2)


HELD = [
    pytest.param([], 2, id="all are free: amplitude and phase in common are held"),
    pytest.param([0], 1, id="one amplitude is not: the phase in common is held"),
    pytest.param([0, 3], 0, id="an amplitude and a phase are not: nothing is held"),
]


@pytest.mark.parametrize(("left_out", "n_held"), HELD)
@pytest.mark.parametrize("n_blocks", [1, 2])
def test_what_is_undecidable_is_held_where_all_of_it_is_free(left_out: list[int], n_held: int, n_blocks: int) -> None:
    prior_var = np.ones(2 * N_ANTENNAS)
    prior_var[left_out] = 0.0
    x = generator(1, "held").standard_normal((n_blocks, 2 * N_ANTENNAS)) * prior_var
    found = Active.start(AntennaGains(), EXPERIMENT, prior_var, x)
    assert len(found.degenerate_directions) == n_held
    np.testing.assert_allclose(found.x @ found.degenerate_directions.T, 0, atol=1e-12)
    # Nothing else of the values is changed.
    kept = np.eye(2 * N_ANTENNAS) - found.degenerate_directions.T @ found.degenerate_directions
    np.testing.assert_allclose(found.x, np.broadcast_to(x @ kept, (2, 2 * N_ANTENNAS)), atol=1e-12)


def test_what_is_in_use_of_all_effects_side_by_side() -> None:
    gains = Active.start(AntennaGains(), EXPERIMENT, np.arange(14.0), np.zeros(14))
    delays = Active.start(AntennaDelays(), EXPERIMENT, np.array([0, 3.0, 0, 5, *[0.0] * 10]), np.zeros(14))
    one = Values().extended(gains)
    both = one.extended(delays)
    assert [effect.kind for effect in one.active] == ["antenna_gains"]
    assert [effect.kind for effect in both.active] == ["antenna_gains", "antenna_delays"]
    variances = [*np.arange(1.0, 14), 3.0, 5.0]
    for channel in (0, 1):
        np.testing.assert_allclose(both.prior_std(channel) ** 2, variances)
        np.testing.assert_allclose(both.prior_precision(channel), np.diag(1 / np.array(variances)))
        x = generator(channel, "prior").standard_normal((2, 15))
        x[1, 13:] = x[0, 13:]  # channels share the delays
        np.testing.assert_allclose(both.at(x).prior_score(channel), -x[channel] / variances)
    once = np.sum(x**2 / variances) - np.sum(x[1, 13:] ** 2 / variances[13:])
    log_prior = sum(effect.prior.log_density(effect.x[:, effect.used]) for effect in both.at(x).active)
    assert log_prior == pytest.approx(-0.5 * once)
    np.testing.assert_array_equal(both.shared, [False] * 13 + [True] * 2)
    assert Values().shared.dtype == bool
    assert len(Values().prior_std(0)) == len(Values().shared) == 0


def test_unknowns_have_names_and_units() -> None:
    setup, gains = small_setup(), AntennaGains()
    parameters = gains.parameters(setup)
    prior_var = np.zeros(len(parameters))
    prior_var[[1, 4]] = 1.0
    active = Active.start(gains, setup, prior_var, np.zeros((1, len(parameters))))
    assert active.labels(setup) == [(parameters.names[1], "rad"), (parameters.names[4], "")]
    beam = BeamBlock(setup.basis, active.prior)
    assert beam.labels(setup)[2] == ("coefficient 2 of the beam", "")
    assert len(beam.labels(setup)) == beam.size


def test_values_in_use_go_back_where_they_came_from() -> None:
    """Into new values: those before stay as they are."""
    gains = Active.start(AntennaGains(), EXPERIMENT, np.arange(14.0), np.zeros(14))
    delays = Active.start(AntennaDelays(), EXPERIMENT, np.array([0, 3.0, 0, 5, *[0.0] * 10]), np.zeros(14))
    values = Values((gains, delays))
    x = generator(2, "x").standard_normal((2, 15))
    moved = values.at(x)
    np.testing.assert_array_equal(moved.x, x)
    np.testing.assert_array_equal(values.x, 0 * x)
    assert [moved.x[:, span].shape[1] for span in moved.spans] == [13, 2]
    np.testing.assert_array_equal(
        moved.active[1].x[:, [0, 1, 2, 3]], np.stack([0 * x[:, 0], x[:, 13], 0 * x[:, 0], x[:, 14]], 1)
    )
    for one, part in zip(moved.active, values.by_effect(x), strict=True):
        np.testing.assert_array_equal(part, one.x)


@pytest.mark.parametrize("length", [0.25, 1.0])
def test_part_of_the_way(length: float) -> None:
    gains = Active.start(AntennaGains(), EXPERIMENT, np.ones(14), np.zeros(14))
    one = Estimate(Values((gains,)), (Posterior(np.zeros(3), np.eye(3)),))
    two = Estimate(Values((replace(gains, x=gains.x + 4),)), (Posterior(np.array([1.0, 2, 4]), 2 * np.eye(3)),))
    between = one.towards(two, length)
    np.testing.assert_array_equal(between.values.active[0].x, gains.x + 4 * length)
    np.testing.assert_array_equal(between.beams[0].mean, length * np.array([1.0, 2, 4]))
    np.testing.assert_array_equal(between.beams[0].factor, 2 * np.eye(3))


def test_values_can_be_kept_and_read_whatever_was_asked_of_them(tmp_path: Path) -> None:
    """As by a fit that did not converge, whose last values are those that a step was taken from."""
    active = Active.start(AntennaGains(), EXPERIMENT, np.ones(2 * N_ANTENNAS), np.zeros((1, 2 * N_ANTENNAS)))
    values = Values((active,))
    assert values.spans == (slice(0, 2 * N_ANTENNAS),)
    assert values.blocks
    write_object(tmp_path / "values", values)
    assert read_object(tmp_path / "values").spans == values.spans
