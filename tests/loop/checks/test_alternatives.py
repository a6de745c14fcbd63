"""Conventions that data may follow instead of the one stated."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hydrabeam_mpi.data.selection import Selection
from hydrabeam_mpi.io.uvmeta import read_observation
from hydrabeam_mpi.loop.checks.alternatives import time_alternatives
from tests.visibilities import make_uvdata


# IERS Bulletin C: the leap seconds of 1 July 2012, 2015 and 1 January 2017.
@pytest.mark.parametrize(("date", "seconds"), [(2457000.5, 35), (2457400.5, 36), (2459866.2, 37)])
def test_tai_runs_ahead_of_utc_by_the_leap_seconds_of_the_date(date: float, seconds: int, tmp_path: Path) -> None:
    path = tmp_path / "a.uvh5"
    make_uvdata().write_uvh5(str(path), run_check=False)
    observation = read_observation([path], Selection())
    observation = replace(observation, times=observation.times - observation.times[0] + date)
    found = {one.name: one for one in time_alternatives(observation)}
    np.testing.assert_allclose(found["times in TAI"].shift, -seconds, atol=1e-6)
    np.testing.assert_allclose(found["times early by TT - UTC"].shift, seconds + 32.184, atol=1e-6)
    assert found["times in TAI"].remedy.startswith(f"subtract {seconds} s from")
