"""What changes during the night is named with its law and measured; what does not is called constant."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pyuvdata import UVCal

from hydrabeam_mpi.cli import main
from tests.loop.mock import mock_job
from tests.loop.test_loop_command import assert_reproduced, record_of, run_loop

DRIFT = "drift from first to last time"
THREE = (131e6, 131.1e6, 131.2e6)
FEW = ["antenna_gains", "cross_coupling", "catalogue_flux", "missing_sources", "outliers"]


def looked_for(folder: Path, **effect: Any) -> Path:
    return run_loop(mock_job(effect, n_times=24, loop={"effects": FEW}), folder)


def told_of(result: Path, law: str, kind: str = "antenna_gains") -> dict[str, tuple[float, float]]:
    """Return the parameters of the one effect that was found, with their errors."""
    record = record_of(result)
    assert record["verdict"] == "explained"
    (found,) = record["rounds"]
    assert (found["effect"], found["law"]) == (kind, law)
    return {one["name"]: (one["value"], one["std"]) for one in found["parameters"]}


@pytest.fixture(scope="module")
def drifting(tmp_path_factory: pytest.TempPathFactory) -> Path:
    settings, name = {"law": "smooth", "orders": [1]}, f"antenna 3 ln amplitude, {DRIFT}"
    folder = tmp_path_factory.mktemp("drifting")
    return looked_for(folder, kind="antenna_gains", settings=settings, parameters={name: 0.03})


def test_a_gain_that_only_drifts_is_named_and_measured(drifting: Path) -> None:
    value, error = told_of(drifting, "smooth")[f"antenna 3 ln amplitude, {DRIFT}"]
    assert error < 0.001
    assert value == pytest.approx(0.03, abs=3 * error)
    assert f"Antenna gains that drift: antenna 3 ln amplitude, {DRIFT}" in record_of(drifting)["rounds"][0]["sentence"]


def test_the_amended_job_has_the_law(drifting: Path) -> None:
    assert main(["infer", str(drifting / "amended.toml"), "-o", str(drifting.parent / "again")]) == 0
    assert_reproduced(drifting, drifting.parent / "again")


def test_gains_that_are_taken_out_drift(drifting: Path) -> None:
    out = drifting.parent / "corrected"
    assert main(["correct", str(drifting), str(drifting.parent / "job.toml"), "-o", str(out)]) == 0
    gains = np.abs(UVCal.from_file(out / "gains.calfits").get_gains(3)).ravel()
    assert gains[-1] / gains[0] == pytest.approx(np.exp(0.03), abs=0.003)


def test_a_gain_that_is_off_is_called_constant(tmp_path: Path) -> None:
    name = "antenna 3 ln amplitude"
    value, error = told_of(looked_for(tmp_path, kind="antenna_gains", parameters={name: 0.03}), "constant")[name]
    assert value == pytest.approx(0.03, abs=3 * error)


def test_a_jump_is_placed_where_held_out_times_say(tmp_path: Path) -> None:
    """The time just after it is held out."""
    settings = {"law": "piecewise", "jumps": [2459866.705478]}
    name = "antenna 3 phase, jump at JD 2459866.70548"
    result = looked_for(tmp_path, kind="antenna_gains", settings=settings, parameters={name: 0.05})
    value, error = told_of(result, "piecewise")[name]
    assert value == pytest.approx(0.05, abs=3 * error)


def test_coupling_that_drifts_about_zero(tmp_path: Path) -> None:
    settings = {"law": "smooth", "orders": [1], "baselines": [[1, 5]]}
    names = {f"baseline 1-5 {part}, {DRIFT}": value for part, value in (("real", 1e-3), ("imaginary", -2e-3))}
    result = looked_for(tmp_path, kind="cross_coupling", settings=settings, parameters=names)
    told = told_of(result, "smooth", "cross_coupling")
    for name, truth in names.items():
        assert told[name][0] == pytest.approx(truth, abs=3 * told[name][1])


def test_what_all_gains_do_alike_is_told_as_such(tmp_path: Path) -> None:
    name = f"all antennas ln amplitude, {DRIFT}"
    settings = {"law": "smooth", "orders": [1]}
    result = looked_for(tmp_path, kind="antenna_gains", settings=settings, parameters={name: 0.02})
    value, error = told_of(result, "smooth")[name]
    assert value == pytest.approx(0.02, abs=3 * error)


@pytest.mark.study
def test_a_drift_of_all_channels_is_one_number(tmp_path: Path) -> None:
    settings, name = {"law": "smooth", "orders": [1], "channels": "alike"}, f"antenna 3 ln amplitude, {DRIFT}"
    effect = {"kind": "antenna_gains", "settings": settings, "parameters": {name: 0.02}}
    result = run_loop(mock_job(effect, n_times=24, freqs=THREE, loop={"effects": FEW}), tmp_path)
    value, error = told_of(result, "smooth")[name]
    assert value == pytest.approx(0.02, abs=3 * error)
    (found,) = record_of(result)["rounds"]
    assert found["title"] == "antenna gains that drift, the same in all channels"
    assert found["n_parameters"] == len(found["parameters"]) == 1
    assert main(["infer", str(result / "amended.toml"), "-o", str(result.parent / "again")]) == 0
    assert_reproduced(result, result.parent / "again")
