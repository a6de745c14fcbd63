"""Bursts in a few rows of data in which something else is missing as well: neither hides the other."""

from __future__ import annotations

from pathlib import Path

import pytest
from mpi4py import MPI

from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.instrument.cross_coupling import CrossCoupling
from hydrabeam_mpi.effects.noise.outliers import Outliers
from hydrabeam_mpi.fit.clock import Clock
from hydrabeam_mpi.fit.state import Values
from hydrabeam_mpi.loop.selection.rounds import begin, run_rounds
from tests.loop.mock import context_of, mock_job

GAIN = {"kind": "antenna_gains", "parameters": {"antenna 2 ln amplitude": 0.1, "antenna 2 phase": -0.1}}
BURSTS = {"kind": "outliers", "parameters": {"fraction of rows hit": 0.01, "scale of |z|^2 where hit": 1e5}}


@pytest.mark.mpi
def test_bursts_and_a_gain(comm: MPI.Comm, common_tmp_path: Path) -> None:
    context = context_of(mock_job(GAIN, BURSTS, n_times=30), common_tmp_path, comm)
    history = begin(context, Values(), Clock())
    run_rounds(context, history, [AntennaGains(), CrossCoupling()], [Outliers()], Clock(), lambda _: None)
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
