"""What drifts in several nights: alike in each it predicts another night, anew in each it says how far off that is."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hydrabeam_mpi.cli import main
from hydrabeam_mpi.data.observation import SIDEREAL_DAY
from tests.loop.mock import mock_job, write_job
from tests.loop.test_laws_in_time import DRIFT
from tests.loop.test_loop_command import record_of, run_loop

START = 2459866.0


def first_two_and_third(folder: Path, settings: dict[str, Any], sizes: dict[str, float]) -> tuple[Any, Any]:
    """Return what is found in two nights, and how near that comes to the third."""
    effect = {"kind": "antenna_gains", "settings": settings, "parameters": sizes}
    job = mock_job(effect, n_times=10, loop={"effects": ["antenna_gains", "cross_coupling"]}, holdout={"every": 2})
    job["data"]["simulate"] |= {"nights": 3, "lst_range": ["6 h", "9 h"], "start": START}
    assert main(["simulate", str(write_job(job, folder, "all.toml")), "-o", str(folder / "all")]) == 0

    def of_nights(*jd: float) -> dict[str, Any]:
        data = {"files": [str(folder / "all" / "data.uvh5")], "time_range": list(jd)}
        return {**job, "data": data, "noise": {"kind": "autocorrelations"}}

    third = write_job(of_nights(START + 2.4 * SIDEREAL_DAY, START + 4), folder, "third.toml")
    result = run_loop(of_nights(START, START + 2.4 * SIDEREAL_DAY), folder / "first")
    assert main(["predict", str(result), str(third), "-o", str(folder / "predicted")]) == 0
    return record_of(result), json.loads((folder / "predicted" / "prediction.json").read_text())


def test_what_is_alike_each_night_predicts_another_one(tmp_path: Path) -> None:
    name = f"antenna 3 ln amplitude, {DRIFT}"
    record, told = first_two_and_third(tmp_path, {"law": "sidereal", "orders": [1]}, {name: 0.03})
    (found,) = record["rounds"]
    assert (found["law"], record["verdict"]) == ("sidereal", "explained")
    values = {one["name"]: (one["value"], one["std"]) for one in found["parameters"]}
    assert abs(values[name][0] - 0.03) < 3 * values[name][1]
    assert [one["title"] for one in told["carried_over"]] == ["antenna gains that drift by sidereal time"]
    assert told["noise_only_chi2"] < 1.2
    assert told["rms_expected"] == pytest.approx(told["rms"], rel=0.1)


def test_what_begins_anew_is_an_error_of_what_is_predicted(tmp_path: Path) -> None:
    names = [
        f"antenna {ant} {part}, night {n}: {DRIFT}"
        for ant in (1, 3)
        for part in ("ln amplitude", "phase")
        for n in (1, 2, 3)
    ]
    sizes = np.array([1, -1.5, 1, -1, 1, 2, -2, 1, 1.5, 1.3, -1, -1.2])
    settings = {"law": "nightly", "orders": [1, 1, 1], "nights": [0, 1, 2]}
    record, told = first_two_and_third(tmp_path, settings, dict(zip(names, (0.02 * sizes).tolist(), strict=True)))
    assert record["rounds"][0]["law"] == "nightly"
    assert record["verdict"] == "explained"
    assert not told["carried_over"]
    assert "antenna gains that drift anew each night: antenna 3 phase, night 1: " + DRIFT in told["at_prior"]
    assert told["noise_only_chi2"] > 20
    assert 0.3 < told["predictive_chi2"] < 3
    assert 0.5 < told["rms"] / told["rms_expected"] < 2
