"""A few integrations with something else in them, beside a gain that is wrong: they are left out, and it is found."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.instrument.cross_coupling import CrossCoupling
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
BAD = {"kind": "bad_integrations", "strength": 100.0}


def search_of(comm: MPI.Comm, folder: Path, *injected: dict[str, object]) -> tuple[FitContext, History]:
    context = context_of(mock_job(*injected, n_times=40), folder, comm)
    history = begin(context, Values(), Clock())
    effects, changes = [AntennaGains(), CrossCoupling()], [Outliers(), BadIntegrations()]
    run_search(Search(context, history, effects, changes, Clock(), lambda _: None))
    return context, history


@pytest.mark.mpi
def test_bad_integrations_and_a_gain(comm: MPI.Comm, common_tmp_path: Path) -> None:
    context, history = search_of(comm, common_tmp_path, GAIN, BAD)
    assert [one.candidate.kind for one in history.rounds if not one.revoked] == ["bad_integrations", "antenna_gains"]
    (bad,), (gains,) = history.last.fitted.values.reweighted, history.last.fitted.values.active
    (truth,) = (one["values"] for one in truth_of(common_tmp_path) if one["kind"] == "bad_integrations")
    names = list(bad.change.neutral(context.setup))
    injected = {name: scale for name, scale in zip(names, truth, strict=True) if scale > 1}
    found = {names[k]: (bad.x[0, k], bad.std[0, k]) for k in np.flatnonzero(bad.x[0] > 1)}
    # One that is hardly larger than the others may stay.
    assert set(found) <= set(injected)
    assert {name for name, scale in injected.items() if scale > 3} <= set(found)
    # What the beam has taken of the fitted rows, as few as they are, is no error that is counted.
    assert all(abs(scale / injected[name] - 1) < 5 * std / scale for name, (scale, std) in found.items())
    assert [name for name, _ in gains.labels(context.setup)] == list(GAIN["parameters"])
    assert history.last.remains.consistent
    record = make_record(context, history, [], {"found": None}, None)
    (told,) = (one for one in record["rounds"] if one["effect"] == "bad_integrations")
    assert [one["name"] for one in told["parameters"]] == list(found)
    assert len(told["left_out"]["times"]) >= 1
    assert told["left_out"]["n"] == len(found) * context.setup.observation.Nbls


def test_without_bad_integrations_none_are_left_out(comm: MPI.Comm, common_tmp_path: Path) -> None:
    _, history = search_of(comm, common_tmp_path, GAIN)
    assert [one.candidate.kind for one in history.rounds] == ["antenna_gains"]
