"""A fit of one night applied to another: it is as good there as on its own held-out data."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from pyuvdata import UVData

import hydrabeam_mpi as hb
from hydrabeam_mpi.api.prediction import left_of_heldout
from hydrabeam_mpi.cli import main
from hydrabeam_mpi.loop.selection.heldout_numbers import IN_SUMMARY
from tests.api.nights import Nights, predicted
from tests.loop.test_loop_command import TWO, summary_of

RUN = """
import sys
from hydrabeam_mpi.cli import main
assert main(["predict", *sys.argv[1:3], "-o", sys.argv[3]]) == 0
"""


@pytest.fixture(scope="module")
def second(nights: Nights) -> dict[str, Any]:
    return predicted(nights.result, nights.job("second"), nights.folder / "prediction")


def test_held_out_data_alone_have_the_numbers_that_they_had(nights: Nights) -> None:
    uvd = UVData.from_file(str(nights.data("first")))
    uvd.select(times=np.unique(uvd.time_array)[2::3])
    uvd.write_uvh5(str(nights.folder / "heldout.uvh5"))
    job = nights.job("first", "_heldout", files=[str(nights.folder / "heldout.uvh5")])
    told = predicted(nights.result, job, nights.folder / "again")
    for one, two in zip(summary_of(nights.result)["channels"], told["channels"], strict=True):
        assert one["freq_hz"] == two["freq_hz"]
        for name, own in IN_SUMMARY.items():
            assert two[own] == pytest.approx(one[name], rel=1e-8), name


def test_a_result_that_left_more_than_noise_is_expected_to_leave_more(second: dict[str, Any], nights: Nights) -> None:
    own = summary_of(nights.result)["channels"]
    factor = left_of_heldout(own)
    np.testing.assert_allclose(factor**2, [max(one["heldout_chi2_predictive"], 1.0) for one in own])
    for one, here in zip(second["channels"], factor, strict=True):
        assert one["rms_expected_as_heldout"] == pytest.approx(one["rms_expected"] * here, rel=1e-12)
    np.testing.assert_allclose(
        second["rms_expected_as_heldout"] / second["rms_expected"], np.sqrt(np.mean(factor**2)), rtol=1e-12
    )
    some = [{"heldout_chi2_predictive": 0.9}, {"heldout_chi2_predictive": 4.0}, {}]
    np.testing.assert_array_equal(left_of_heldout(some), [1, 2, np.nan])


def test_another_night_is_predicted_as_well(second: dict[str, Any]) -> None:
    n = 12 * 21 * len(TWO)
    assert second["n"] == n
    assert second["predictive_chi2"] == pytest.approx(1, abs=4 / np.sqrt(n))
    assert second["explained"] > 0.9999
    assert second["rms"] < 1.2 * second["rms_noise"]
    assert second["rms_model"] > second["rms_model_scaled"] > 30 * second["rms"]
    assert second["rms_zero"] > second["rms_model"]
    assert [one["effect"] for one in second["carried_over"]] == ["antenna_gains", "missing_sources"]
    assert second["not_carried_over"] == second["at_prior"] == second["warnings"] == []


def test_an_antenna_that_is_not_there_is_not_needed(nights: Nights) -> None:
    job = nights.job("second", "_without", exclude_antennas=[2], freqs=[f"{TWO[1] / 1e6} MHz"])
    told = predicted(nights.result, job, nights.folder / "without")
    assert [one["freq_hz"] for one in told["channels"]] == [TWO[1]]
    assert told["predictive_chi2"] == pytest.approx(1, abs=4 / np.sqrt(told["n"]))
    assert [one["effect"] for one in told["carried_over"]] == ["missing_sources"]
    (left,) = told["not_carried_over"]
    assert left["parameters"] == ["antenna 2 ln amplitude", "antenna 2 phase"]
    assert left["reason"] == "is of what these data do not have"


@pytest.mark.parametrize("command", ["predict", "correct", "infer"])
def test_antennas_elsewhere_are_others(
    command: str, nights: Nights, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """What was found of antenna 2 says nothing of one that has its number, where the result is applied or the prior."""
    uvd = UVData.from_file(str(nights.data("second")))
    uvd.telescope.antenna_positions = 1.3 * uvd.telescope.antenna_positions
    uvd.write_uvh5(str(tmp_path / "moved.uvh5"))
    job = nights.job("second", "_moved", files=[str(tmp_path / "moved.uvh5")])
    source = [str(nights.result)]
    if command == "infer":
        prior, source = {"prior": {"file": str(nights.result)}}, []
        job.write_text(tomli_w.dumps(tomllib.loads(job.read_text()) | prior))
    assert main([command, *source, str(job), "-o", str(tmp_path / "out")]) == 2
    said = capfd.readouterr().err.splitlines()[-1]
    assert "[data] files: antenna 2 stands up to 4.38 m elsewhere than in the result's own data" in said
    assert "exclude_antennas = [2] in [data]" in said


def test_far_more_than_expected_is_warned_of(nights: Nights, capfd: pytest.CaptureFixture[str]) -> None:
    job = nights.job("second", "_faint", flux_scale=0.3)
    capfd.readouterr()
    told = predicted(nights.result, job, nights.folder / "faint")
    assert told["rms"] > told["rms_zero"]
    far, worse = told["warnings"]
    assert far.startswith("Reduced chi^2 is up to ")
    assert "under the posterior predictive (noise, beam and effects): these data are not as the result has it" in far
    assert worse == "At 131, 139 MHz the prediction leaves more of the data than predicting zero does."
    said = capfd.readouterr().err
    assert all(f"warning: {line}" in said for line in told["warnings"])


def test_two_ranks_and_python_say_the_same(
    nights: Nights, second: dict[str, Any], tmp_path: Path, mpiexec_python: Any
) -> None:
    job = nights.job("second")
    done = mpiexec_python(2, RUN, nights.result, job, tmp_path / "two")
    assert done.returncode == 0, done.stderr
    own = hb.predict(str(nights.result), hb.Setup.from_job(job))
    own.write(tmp_path / "own")
    for folder in ("two", "own"):
        told = json.loads((tmp_path / folder / "prediction.json").read_text())
        assert told.keys() == second.keys()
        for name in told.keys() - {"phases_s", "channels", "result"}:
            same = pytest.approx(second[name], rel=1e-9) if isinstance(second[name], float) else second[name]
            assert told[name] == same, name
    assert {path.name for path in (tmp_path / "own").iterdir()} == {
        "prediction.json", "job.toml", "provenance.json", "manifest.json",
    }  # fmt: skip
