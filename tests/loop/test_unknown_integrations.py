"""Integrations with a signal of the sky beside a gain that is wrong: they are left out, and the gain is found."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from mpi4py import MPI

from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.instrument.cross_coupling import CrossCoupling
from hydrabeam_mpi.effects.noise.bad_baselines import BadBaselines
from hydrabeam_mpi.effects.noise.bad_integrations import BadIntegrations
from hydrabeam_mpi.effects.noise.outliers import Outliers
from hydrabeam_mpi.effects.noise.unknown_integrations import UnknownIntegrations
from hydrabeam_mpi.fit.clock import Clock
from hydrabeam_mpi.fit.state import Values
from hydrabeam_mpi.loop.output.record import make_record
from hydrabeam_mpi.loop.selection.first_and_last import begin
from hydrabeam_mpi.loop.selection.rounds import Search
from hydrabeam_mpi.loop.selection.search import run_search
from tests.loop.mock import context_of, mock_job

GAIN = {"kind": "antenna_gains", "parameters": {"antenna 2 ln amplitude": 0.02, "antenna 2 phase": -0.02}}


def record_of(comm: MPI.Comm, folder: Path, *scales: tuple[bool, float]) -> tuple[dict[str, Any], list[str]]:
    """Run the loop with a signal in held-out (or fitted) integrations; return what it says and which these are."""
    context = context_of(mock_job(n_times=40), folder / "times", comm)
    names = list(UnknownIntegrations().neutral(context.setup))
    held_out = {time for share in comm.allgather(context.test.rows.tile.times.tolist()) for time in share}
    have: dict[str, float] = {}
    for is_held_out, scale in scales:
        free = (name for t, name in enumerate(names) if t > 10 and (t in held_out) == is_held_out)
        have[next(name for name in free if name not in have)] = scale
    signal = {"kind": "unknown_integrations", "parameters": have}
    context = context_of(mock_job(GAIN, signal, n_times=40), folder / "data", comm)
    history = begin(context, Values(), Clock())
    changes = [Outliers(), BadIntegrations(), UnknownIntegrations(), BadBaselines()]
    run_search(Search(context, history, [AntennaGains(), CrossCoupling()], changes, Clock(), lambda _: None))
    return make_record(context, history, [], {"found": None}, None), list(have)


@pytest.mark.mpi
@pytest.mark.parametrize("signals", [[(True, 30.0)], [(False, 30.0), (True, 8.0), (False, 10.0)]])
def test_they_are_left_out(comm: MPI.Comm, common_tmp_path: Path, signals: list[tuple[bool, float]]) -> None:
    record, have = record_of(comm, common_tmp_path, *signals)
    rounds = {one["effect"]: one for one in record["rounds"] if not one["revoked"]}
    assert set(rounds) == {"antenna_gains", "unknown_integrations"}
    assert [one["name"] for one in rounds["antenna_gains"]["parameters"]] == list(GAIN["parameters"])
    assert {one["name"] for one in rounds["unknown_integrations"]["parameters"]} == set(have)
    assert rounds["unknown_integrations"]["of_unknown"]
    assert record["verdict"] == "unexplained"
    assert "of all others nothing significant is left" in record["why"]
    lost = rounds["unknown_integrations"]["left_out"]["times"]
    assert sum(one["integrations"] for one in lost) == len(have)
    assert record["error_after"] < 1.1
