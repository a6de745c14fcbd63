"""A beam that changes in time: weighed beside the effects, and never one of them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from hydrabeam_mpi.cli import main
from hydrabeam_mpi.effects.catalogue import EFFECTS
from hydrabeam_mpi.loop.attribution import attribute
from hydrabeam_mpi.loop.drift import SHAPE, BeamDrift, ShapeDrift
from hydrabeam_mpi.loop.refit import refit
from hydrabeam_mpi.loop.state import Active, State
from tests.loop.mock import mock_job, space_of, write_job
from tests.validation.undeclared.generate import generate


def test_it_is_the_design_times_the_time(tmp_path: Path) -> None:
    """What its columns add to a model is what a beam does whose coefficients grow linearly in time."""
    space = space_of(mock_job(), tmp_path)
    state = refit(space, State())
    effect, times = BeamDrift(), space.experiment.observation.times
    n = len(effect.parameters(space.experiment))
    assert n == 24
    x = 0.01 * np.arange(n)
    rows, added = space.train.calibrated(state)
    middle = 0.5 * (times.min() + times.max())
    for _, scene, design in space.train.scenes(0, state, added[0], rows):
        time = (times[scene.times] - middle) / (0.5 * np.ptp(times))
        parts = np.einsum("tpgn,tn->tpg", design, time[:, np.newaxis] * x)
        expected = scene.spread(parts[:, 0] + 1j * parts[:, 1])
        np.testing.assert_allclose(effect.added(scene, x), expected, rtol=1e-6)  # dates have 16 digits


def test_it_is_not_in_constant_data(tmp_path: Path) -> None:
    space = space_of(mock_job(), tmp_path)
    finding = attribute(space, refit(space, State()), [BeamDrift()])[0]
    assert finding.evidence.log_bayes_factor < 3


def test_a_fit_finds_it(tmp_path: Path) -> None:
    space = space_of(mock_job(), tmp_path)
    effect = BeamDrift()
    parameters = effect.parameters(space.experiment)
    truth = 0.05 * parameters.scale
    state = refit(space, State())
    rows, added = space.train.calibrated(state)
    for span, scene, _ in space.train.scenes(0, state, added[0], rows):
        space.train.rows.data[0, span] += effect.added(scene, truth)
    start = refit(space, State())
    evidence = attribute(space, start, [effect])[0].evidence
    assert evidence.log_bayes_factor > 100
    fitted = refit(space, start.extended(Active.start(effect, space.experiment, evidence.prior_var, evidence.x)))
    last = fitted.active[-1]
    z = (last.x[0] - truth)[last.used] / last.std[0, last.used]
    assert np.mean(z**2) < 2.5


def test_a_drifting_beam_is_given_no_other_name(tmp_path: Path) -> None:
    generate(503, tmp_path, "drifting_beam")
    assert main(["loop", str(tmp_path / "given" / "job.toml"), "-o", str(tmp_path / "out")]) == 0
    loop = json.loads((tmp_path / "out" / "loop.json").read_text())
    assert loop["verdict"] == "unexplained"
    assert loop["rounds"] == []
    assert loop["foreign"]["effect"] == "beam_drift"
    assert loop["foreign"]["heldout_after"] < loop["error_after"]
    assert "a beam that changes in time" in loop["said"][-1].lower()
    assert {one["effect"] for one in loop["last_ranking"]} <= {*EFFECTS, "noise_level", "outliers"}


def test_few_times_cannot_tell(tmp_path: Path) -> None:
    job = write_job(mock_job(n_times=3), tmp_path)
    assert main(["loop", str(job), "-o", str(tmp_path / "out")]) == 0


def test_a_shape_that_changes_is_told_by_few_numbers(tmp_path: Path) -> None:
    """A main lobe that grows wider by a hundredth, of a beam whose modes would all have to change."""
    space = space_of(mock_job(), tmp_path)
    effect = ShapeDrift()
    state = refit(space, State())
    rows, added = space.train.calibrated(state)
    truth = np.zeros(len(SHAPE))
    truth[SHAPE.index("width East-West")] = 0.01
    for span, scene, _ in space.train.scenes(0, state, added[0], rows):
        scene.integrate_for([effect])
        space.train.rows.data[0, span] += effect.added(scene, truth)
    shape, modes = sorted(
        attribute(space, refit(space, State()), [effect, BeamDrift()]),
        key=lambda one: -one.evidence.log_bayes_factor,
    )
    assert isinstance(shape.effect, ShapeDrift)
    assert shape.evidence.log_bayes_factor > modes.evidence.log_bayes_factor + 10
    assert np.argmax(np.abs(shape.evidence.x[0])) == SHAPE.index("width East-West")
    assert shape.evidence.x[0].max() == pytest.approx(0.01, rel=0.1)
