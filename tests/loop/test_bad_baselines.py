"""A few baselines with something else in them, beside a gain that is wrong: they are left out, and it is found."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.instrument.cross_coupling import CrossCoupling
from hydrabeam_mpi.effects.noise.bad_baselines import BadBaselines
from hydrabeam_mpi.effects.noise.bad_integrations import BadIntegrations
from hydrabeam_mpi.effects.noise.outliers import Outliers
from hydrabeam_mpi.fit.clock import Clock
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.state import Values
from hydrabeam_mpi.loop.output.record import make_record
from hydrabeam_mpi.loop.selection.first_and_last import begin
from hydrabeam_mpi.loop.selection.history import History
from hydrabeam_mpi.loop.selection.rounds import Search
from hydrabeam_mpi.loop.selection.search import run_search
from tests.loop.mock import context_of, mock_job, truth_of

GAIN = {"kind": "antenna_gains", "parameters": {"antenna 2 ln amplitude": 0.02, "antenna 2 phase": -0.02}}
COUPLED = {"kind": "cross_coupling", "settings": {"baselines": [[1, 4]]}, "parameters": {"baseline 1-4 real": 0.01}}
BAD = {"kind": "bad_baselines", "strength": 100.0}


def search_of(comm: MPI.Comm, folder: Path, *injected: dict[str, object]) -> tuple[FitContext, History]:
    context = context_of(mock_job(*injected, n_times=40), folder, comm)
    history = begin(context, Values(), Clock())
    changes = [Outliers(), BadIntegrations(), BadBaselines()]
    run_search(Search(context, history, [AntennaGains(), CrossCoupling()], changes, Clock(), lambda _: None))
    return context, history


@pytest.mark.mpi
def test_bad_baselines_and_a_gain(comm: MPI.Comm, common_tmp_path: Path) -> None:
    context, history = search_of(comm, common_tmp_path, GAIN, BAD)
    assert {one.candidate.kind for one in history.rounds if not one.revoked} == {"antenna_gains", "bad_baselines"}
    (bad,), (gains,) = history.last.fitted.values.reweighted, history.last.fitted.values.active
    (truth,) = (one["values"] for one in truth_of(common_tmp_path) if one["kind"] == "bad_baselines")
    np.testing.assert_array_equal(bad.x[0] > 1, np.array(truth) > 1)
    assert [name for name, _ in gains.labels(context.setup)] == list(GAIN["parameters"])
    assert history.last.remains.consistent
    record = make_record(context, history, [], {"found": None}, None)
    assert record["verdict"] == "unexplained"
    assert record["where"] is None
    (told,) = (one for one in record["rounds"] if one["effect"] == "bad_baselines")
    pairs = context.setup.observation.antpairs[np.array(truth) > 1].tolist()
    assert [one["what"] for one in told["left_out"]["baselines"]] == pairs
    assert "antenna gains, and some of the data carry something that no effect" in record["sentence"]
    assert "of all others nothing significant is left" in record["sentence"]
    assert all(f"100% of baseline {one}-{two}" in record["sentence"] for one, two in pairs)


def test_what_an_effect_explains_is_not_bad(comm: MPI.Comm, common_tmp_path: Path) -> None:
    _, history = search_of(comm, common_tmp_path, COUPLED)
    assert [one.candidate.kind for one in history.rounds] == ["cross_coupling"]
    assert history.last.remains.consistent
