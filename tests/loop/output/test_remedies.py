"""Where an unexplained residual is in few places, how to leave these out is said of each."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hydrabeam_mpi.config.sections import Data
from hydrabeam_mpi.data.observation import Observation
from hydrabeam_mpi.data.selection import Selection
from hydrabeam_mpi.io.uvmeta import read_observation
from hydrabeam_mpi.loop.output.remedies import leave_out
from tests.visibilities import CROSS, make_uvdata


@pytest.fixture
def observation(tmp_path: Path) -> Observation:
    make_uvdata().write_uvh5(str(tmp_path / "a.uvh5"), run_check=False)
    return read_observation([tmp_path / "a.uvh5"], Selection())


def entry(what: object, share: float = 0.4) -> dict[str, object]:
    return {"what": what, "chi2": 50.0, "share": share, "sigma": 12.34}


def test_integrations_can_be_left_out_by_the_key_that_is_given(observation: Observation) -> None:
    bad = [1, 4]
    entries = [entry({"jd": float(observation.times[t])}) for t in bad]
    where = {"times": {"state": "concentrated", "count": 2, "entries": [*entries, entry({"jd": 1.0}, 0.01)]}}
    told = leave_out(where, observation)
    assert [one.where for one in told] == [f"JD {observation.times[t]:.6f}" for t in bad]
    assert "it has 40% of what no effect explains (12.3 sigma)" in told[0].line
    for one, t in zip(told, bad, strict=True):
        spans = one.remedy.partition(" = [[")[2].partition("]]")[0].split(",")
        given = Data(files=("a",), exclude_times=((float(spans[0]), float(spans[1])),))
        excluded = replace(observation, exclude_times=given.exclude_times)
        found = excluded.excluded(np.arange(observation.Ntimes), observation.antpairs).all(axis=1)
        assert np.flatnonzero(found).tolist() == [t]


def test_antennas_stand_for_their_baselines(observation: Observation) -> None:
    antennas = {"state": "concentrated", "count": 1, "entries": [entry(7)]}
    baselines = {"state": "concentrated", "count": 1, "entries": [entry(list(CROSS[0]))]}
    (one,) = leave_out({"antennas": antennas, "baselines": baselines}, observation)
    assert one.remedy == "if it is bad, exclude_antennas = [7] in [data]"
    (one,) = leave_out({"antennas": {"state": "uneven"}, "baselines": baselines}, observation)
    assert one.remedy == "if it is bad, exclude_baselines = [[3, 7]] in [data]"


def test_what_is_everywhere_is_not_left_out(observation: Observation) -> None:
    where = {"sentence": "Everywhere.", "times": {"state": "even", "count": 6, "entries": []}}
    assert leave_out(where, observation) == []
