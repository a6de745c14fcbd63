"""Bursts in a few rows of data in which something else is missing as well: neither hides the other."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.instrument.cross_coupling import CrossCoupling
from hydrabeam_mpi.effects.interface.reweighting import ReweightingFit
from hydrabeam_mpi.effects.noise.outliers import Outliers
from hydrabeam_mpi.fit.clock import Clock
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.state import Reweighted, Values
from hydrabeam_mpi.loop.attribution.score_noise import WeightsFound
from hydrabeam_mpi.loop.selection.acceptance import Candidate
from hydrabeam_mpi.loop.selection.first_and_last import begin
from hydrabeam_mpi.loop.selection.predictions import check
from hydrabeam_mpi.loop.selection.refusal import refusal_of
from hydrabeam_mpi.loop.selection.rounds import Search, run_rounds
from tests.loop.mock import context_of, mock_job

GAIN = {"kind": "antenna_gains", "parameters": {"antenna 2 ln amplitude": 0.1, "antenna 2 phase": -0.1}}
BURSTS = {"kind": "outliers", "parameters": {"fraction of rows hit": 0.01, "scale of |z|^2 where hit": 1e5}}


def test_bursts_and_a_gain(comm: MPI.Comm, common_tmp_path: Path) -> None:
    context = context_of(mock_job(GAIN, BURSTS, n_times=30), common_tmp_path, comm)
    history = begin(context, Values(), Clock())
    run_rounds(Search(context, history, [AntennaGains(), CrossCoupling()], [Outliers()], Clock(), lambda _: None))
    assert {one.candidate.kind for one in history.rounds if not one.revoked} == {"antenna_gains", "outliers"}
    (gains,) = history.last.fitted.values.active
    used = [name for name, _ in gains.labels(context.setup)]
    assert {"antenna 2 ln amplitude", "antenna 2 phase"} <= set(used)
    assert len(used) <= 4
    (bursts,) = history.last.fitted.values.reweighted
    # Once the gain is known, they are told from noise.
    assert not bursts.change.at_own_level
    assert abs(bursts.x[0, 1] - 0.01) < 4 * bursts.std[0, 1]
    assert history.last.remains.consistent
    (told,) = (one.candidate for one in history.rounds if one.candidate.kind == "outliers")
    assert told.weights is not None
    assert told.weights.change is bursts.change


def test_what_leaves_out_all_rows_is_refused(tmp_path: Path) -> None:
    """As a fit may that goes astray; it is told all the same."""
    context = context_of(mock_job(GAIN), tmp_path)
    before = check(context, refit(context, Values()))
    threshold = np.array([[1e-9, 0.01, 1e3]])
    weights = Reweighted(Outliers(), threshold, np.zeros((1, 3)))
    given = replace(before.fitted, values=Values(reweighted=(weights,)))
    after = check(context, given)
    assert after.score.n_data == 0
    assert after.score.log_density == pytest.approx(-1e-9 * before.score.n_data)
    fit = ReweightingFit(100.0, threshold, np.zeros((1, 3)), ("a", "b", "c"), ("", "", ""), 200.0, 2)
    candidate = Candidate("outliers", "outliers", 100.0, weights=WeightsFound(Outliers(), fit, given))
    reason = refusal_of(before, after, candidate, context.problem.job.loop)
    assert reason is not None
    assert "leaves out all but 0 of" in reason
