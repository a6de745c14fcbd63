"""A beam that changes in time: weighed beside the effects, and never one of them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from hydrabeam_mpi.cli import main
from hydrabeam_mpi.effects.registry import EFFECTS, REWEIGHTINGS
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.state import Active, Values
from hydrabeam_mpi.loop.attribution.control_models import SHAPE, BeamDrift, ShapeDrift
from hydrabeam_mpi.loop.attribution.score_effects import attribute
from tests.loop.mock import context_of, mock_job, write_job
from tests.validation.undeclared.generate import generate


def test_it_is_the_design_times_the_time(tmp_path: Path) -> None:
    """What its columns add to a model is what a beam does whose coefficients grow linearly in time."""
    context = context_of(mock_job(), tmp_path)
    fitted = refit(context, Values())
    effect, times = BeamDrift(), context.setup.observation.times
    n = len(effect.parameters(context.setup))
    assert n == 24
    x = 0.01 * np.arange(n)
    rows, added = context.train.calibrated(fitted.estimate)
    middle = 0.5 * (times.min() + times.max())
    for _, block, design in context.train.row_blocks(0, fitted.estimate, added[0], rows):
        time = (times[block.times] - middle) / (0.5 * np.ptp(times))
        parts = np.einsum("tpgn,tn->tpg", design, time[:, np.newaxis] * x)
        expected = block.spread(parts[:, 0] + 1j * parts[:, 1])
        np.testing.assert_allclose(effect.added(block, x), expected, rtol=1e-6)  # dates have 16 digits


def test_it_is_not_in_constant_data(tmp_path: Path) -> None:
    context = context_of(mock_job(), tmp_path)
    finding = attribute(context, refit(context, Values()), [BeamDrift()])[0]
    assert finding.evidence.log_bayes_factor < 3


def test_a_fit_finds_it(tmp_path: Path) -> None:
    context = context_of(mock_job(), tmp_path)
    effect = BeamDrift()
    parameters = effect.parameters(context.setup)
    truth = 0.05 * parameters.scale
    fitted = refit(context, Values())
    rows, added = context.train.calibrated(fitted.estimate)
    for span, block, _ in context.train.row_blocks(0, fitted.estimate, added[0], rows):
        context.train.rows.data[0, span] += effect.added(block, truth)
    start = refit(context, Values())
    evidence = attribute(context, start, [effect])[0].evidence
    assert evidence.log_bayes_factor > 100
    last = Active.start(effect, context.setup, evidence.prior_var, evidence.x)
    found = refit(context, start.values.extended(last), start)
    (last,), (std,) = found.values.active, found.fit.std
    z = (last.x[0] - truth)[last.used] / std[0, last.used]
    assert np.mean(z**2) < 2.5


@pytest.mark.study
def test_a_drifting_beam_is_given_no_other_name(tmp_path: Path) -> None:
    generate(503, tmp_path, "drifting_beam")
    assert main(["loop", str(tmp_path / "given" / "job.toml"), "-o", str(tmp_path / "out")]) == 0
    loop = json.loads((tmp_path / "out" / "loop.json").read_text())
    assert loop["verdict"] == "unexplained"
    assert loop["rounds"] == []
    assert loop["foreign"]["effect"] == "beam_drift"
    assert loop["foreign"]["heldout_after"] < loop["error_after"]
    assert "a beam that changes in time" in loop["said"][-1].lower()
    assert {one["effect"] for one in loop["last_ranking"]} <= {*EFFECTS, *REWEIGHTINGS}


def test_few_times_cannot_tell(tmp_path: Path) -> None:
    job = write_job(mock_job(n_times=3), tmp_path)
    assert main(["loop", str(job), "-o", str(tmp_path / "out")]) == 0


def test_a_shape_that_changes_is_told_by_few_numbers(tmp_path: Path) -> None:
    """A main lobe that grows wider by a hundredth, of a beam whose modes would all have to change."""
    context = context_of(mock_job(), tmp_path)
    effect = ShapeDrift()
    fitted = refit(context, Values())
    rows, added = context.train.calibrated(fitted.estimate)
    truth = np.zeros(len(SHAPE))
    truth[SHAPE.index("width East-West")] = 0.01
    for span, block, _ in context.train.row_blocks(0, fitted.estimate, added[0], rows):
        block.integrate_for([effect])
        context.train.rows.data[0, span] += effect.added(block, truth)
    shape, modes = sorted(
        attribute(context, refit(context, Values()), [effect, BeamDrift()]),
        key=lambda one: -one.evidence.log_bayes_factor,
    )
    assert isinstance(shape.effect, ShapeDrift)
    assert shape.evidence.log_bayes_factor > modes.evidence.log_bayes_factor + 10
    assert np.argmax(np.abs(shape.evidence.x[0])) == SHAPE.index("width East-West")
    assert shape.evidence.x[0].max() == pytest.approx(0.01, rel=0.1)
