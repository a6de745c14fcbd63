"""`hydrabeam loop` from the command line: what is written and what it says."""

from __future__ import annotations

import json
import shutil
from itertools import cycle
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from mpi4py import MPI
from pyuvdata import UVData

from hydrabeam_mpi.cli import main
from hydrabeam_mpi.config import load_job
from hydrabeam_mpi.effects.registry import EFFECTS, REWEIGHTINGS
from tests.cli.conftest import refusal
from tests.loop.mock import FREQ, mock_job, truth_of, write_job
from tests.report.conftest import BULK, drop_arrays

GAIN = {"kind": "antenna_gains", "parameters": {"antenna 2 ln amplitude": 0.06, "antenna 2 phase": -0.05}}
SHIFT = {"kind": "antenna_positions", "parameters": {"antenna 5 displaced East": 0.08, "antenna 5 displaced Up": 0.1}}
TWO = (FREQ, FREQ + 8e6)
ROUND = {
    "effect", "parameters", "log_bayes_factor", "absorbed_by_beam", "chi2_before", "chi2_after", "heldout_before",
    "heldout_after", "runner_up", "indistinguishable_from",
}  # fmt: skip


def run_loop(job: dict[str, Any], folder: Path) -> Path:
    assert main(["loop", str(write_job(job, folder)), "-o", str(folder / "result")]) == 0
    return folder / "result"


def record_of(result: Path) -> dict[str, Any]:
    return dict(json.loads((result / "loop.json").read_text()))


def summary_of(result: Path) -> dict[str, Any]:
    return dict(json.loads((result / "summary.json").read_text()))


def channels_of(result: Path) -> list[dict[str, Any]]:
    with h5py.File(result / "posterior.h5") as file:
        return [{key: file[name][key][()] for key in file[name]} for name in file if name.startswith("channel")]


@pytest.fixture(scope="module")
def explained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One antenna's gain is off."""
    return run_loop(mock_job(GAIN), tmp_path_factory.mktemp("explained"))


@pytest.fixture(scope="module")
def two_at_once(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One antenna's gain is off, and another one's place; two channels, and some effects to tell them from."""
    others = ["missing_sources", "cross_coupling", "basis_truncation", "noise_level", "outliers"]
    job = mock_job(GAIN, SHIFT, freqs=TWO, loop={"effects": ["antenna_gains", "antenna_positions", *others]})
    return run_loop(job, tmp_path_factory.mktemp("two"))


@pytest.fixture(scope="module")
def by_evidence(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """As the first, in a job that says itself that the data are to choose the widths of the beam's prior."""
    job = mock_job(GAIN, prior={"widths": "evidence"}, loop={"effects": ["antenna_gains"]})
    return run_loop(job, tmp_path_factory.mktemp("evidence"))


def error_of_rounds(record: dict[str, Any]) -> float:
    """Return the held-out reduced chi^2 after the last round, before the beam's prior was adapted."""
    adapted = [one for one in record["prior_widths"] if one["n_rounds"] == len(record["rounds"])]
    return float(adapted[0]["predictive_chi2_before"] if adapted else record["error_after"])


def test_all_is_written(explained: Path) -> None:
    names = {path.name for path in explained.iterdir()}
    assert {"loop.json", "amended.toml", "posterior.h5", "beam.beamfits", "summary.json", "job.toml"} <= names
    record = record_of(explained)
    assert {"rounds", "verdict", "error_before", "error_after", "where"} <= record.keys()
    assert {"name", "said", "tried", "skipped", "undecidable", "conventions", "residual", "seconds"} <= record.keys()
    assert record["warnings"] == summary_of(explained)["warnings"]
    (told,) = record["rounds"]
    assert told.keys() >= ROUND
    assert {"title", "sentence", "ranking", "residual", "heldout_sigma", "beam_change_max"} <= told.keys()
    for parameter in told["parameters"]:
        assert parameter.keys() == {"name", "unit", "value", "std", "sigma", "freq_hz"}
    for ranked in told["ranking"]:
        assert {"effect", "log_bayes_factor", "chi2_drop", "effective_parameters", "n_parameters"} <= ranked.keys()
        assert {"absorbed_by_beam", "rank"} <= ranked.keys()


def test_what_is_wrong_is_named_and_added(explained: Path) -> None:
    record = record_of(explained)
    assert record["verdict"] == "explained"
    assert record["where"] is None
    assert record["error_before"] > 100
    assert record["error_after"] == pytest.approx(1.0, abs=0.35)
    (told,) = record["rounds"]
    assert told["effect"] == "antenna_gains"
    assert told["heldout_before"] == record["error_before"]
    assert told["heldout_after"] == error_of_rounds(record)
    assert record["error_claimed"] == record["error_after"]
    assert told["chi2_before"] > 10
    assert told["chi2_after"] == pytest.approx(1.0, abs=0.3)
    assert told["log_bayes_factor"] > 1000
    assert 0 < told["absorbed_by_beam"] < 1
    assert [one["between"] for one in told["constancy"]] == ["times", "baselines"]
    assert all(one["log_bayes_factor"] > 5 and one["spread"] < 0.1 for one in told["constancy"])
    assert told["runner_up"] in {*EFFECTS, *REWEIGHTINGS}
    assert (told["runner_up"], told["runner_up_law"]) != ("antenna_gains", "constant")
    assert told["indistinguishable_from"] == []
    assert told["sentence"] in record["said"]
    assert "antenna 2" in told["sentence"]
    # The one antenna, and no other.
    assert {one["name"] for one in told["parameters"]} == set(GAIN["parameters"])
    for one in told["parameters"]:
        assert abs(one["value"] - GAIN["parameters"][one["name"]]) < 4 * one["std"]
        assert one["freq_hz"] == FREQ
    assert told["ranking"][0]["effect"] == "antenna_gains"
    evidence = [one["log_bayes_factor"] for one in told["ranking"]]
    assert evidence == sorted(evidence, reverse=True)


def test_two_at_once(two_at_once: Path) -> None:
    record = record_of(two_at_once)
    assert record["verdict"] == "explained"
    assert {one["effect"] for one in record["rounds"]} == {"antenna_gains", "antenna_positions"}
    assert record["error_after"] == pytest.approx(1.0, abs=0.2)
    for one in record["rounds"]:
        assert one["heldout_after"] < max(one["heldout_before"], 1.01)
    # The gains are the same in both channels, and told as such in the end.
    (gains,) = (one for one in record["rounds"] if one["effect"] == "antenna_gains" and not one["revoked"])
    assert (gains["title"], gains["n_parameters"]) == ("antenna gains, the same in all channels", 2)
    # What is written last has all of it; the effects are fitted jointly.
    job = load_job(two_at_once / "amended.toml")
    truth = {one["kind"]: dict(zip(one["names"], one["values"][0], strict=True)) for one in truth_of(two_at_once)}
    known, *found = job.effects
    assert known.kind == "common_beam"
    assert {entry.kind for entry in found} == set(truth)
    for entry in found:
        assert len(entry.values) == 2
        if entry.kind == "antenna_positions":
            assert entry.values[0] == entry.values[1]
        for values, std in zip(entry.values, entry.std, strict=True):
            for name, value, sigma in zip(entry.names, values, std, strict=True):
                assert abs(value - truth[entry.kind][name]) < 4.5 * sigma


@pytest.mark.parametrize("which", ["explained", "two_at_once", "by_evidence"])
def test_infer_takes_the_amended_job(which: str, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    """And comes to the same beam and the same error, without looking for anything."""
    result = request.getfixturevalue(which)
    assert main(["infer", str(result / "amended.toml"), "-o", str(tmp_path / "again")]) == 0
    assert_reproduced(result, tmp_path / "again")
    record = record_of(result)
    assert record["rounds"][-1]["heldout_after"] == error_of_rounds(record)


def assert_reproduced(result: Path, again: Path) -> None:
    """Compare beams to a millionth of their errors, and what is said of held-out data here, there and by the loop."""
    for first, second in zip(channels_of(result), channels_of(again), strict=True):
        assert np.all(np.abs(first["mean"] - second["mean"]) <= 1e-6 * first["std"])
        np.testing.assert_allclose(second["std"], first["std"], rtol=1e-6)
    record = record_of(result)
    for one, two, told in zip(
        *(summary_of(folder)["channels"] for folder in (result, again)), record["heldout_channels"], strict=True
    ):
        names = [name for name in one if name.startswith(("heldout_", "ppd_", "train_", "beam_", "log_"))]
        assert {name: two[name] for name in names} == pytest.approx({name: one[name] for name in names}, rel=1e-6)
        same = told.keys() & one.keys()
        assert {name: told[name] for name in same} == {name: one[name] for name in same}
        assert {"heldout_chi2_predictive", "heldout_rms_jy", "heldout_log_density", "heldout_explained"} <= same
        assert one["heldout_rms_jy"] == told["rms_after"]
        assert one["heldout_log_density"] == told["log_density_after"]


def test_the_loop_takes_the_amended_job(explained: Path, tmp_path: Path) -> None:
    """There is nothing left to find."""
    assert main(["loop", str(explained / "amended.toml"), "-o", str(tmp_path / "again")]) == 0
    record = record_of(tmp_path / "again")
    assert record["verdict"] == "consistent"
    assert record["rounds"] == []
    assert record["error_before"] == pytest.approx(record_of(explained)["error_after"], rel=0.01)
    one, two = (load_job(folder / "amended.toml").effects for folder in (explained, tmp_path / "again"))
    assert [entry.names for entry in one] == [entry.names for entry in two]


def test_infer_is_wrong_without_the_amendment(explained: Path, tmp_path: Path) -> None:
    """So that the tests above compare what can be otherwise."""
    assert main(["infer", str(explained / "job.toml"), "-o", str(tmp_path / "plain")]) == 0
    one, two = summary_of(explained), summary_of(tmp_path / "plain")
    assert two["heldout_chi2_noise_only"] > 100 * one["heldout_chi2_noise_only"]
    assert record_of(explained)["error_before"] == pytest.approx(two["heldout_chi2_noise_only"], rel=0.5)


def test_data_from_files(explained: Path, tmp_path: Path) -> None:
    """The same data, read: the same answer, and the amended job knows the files from anywhere."""
    job = mock_job()
    job["data"] = {"files": [str(explained / "data.uvh5")]}
    record = record_of(run_loop(job, tmp_path))
    assert record["verdict"] == "explained"
    assert record["error_after"] == pytest.approx(record_of(explained)["error_after"], rel=1e-6)
    assert main(["infer", str(tmp_path / "result" / "amended.toml"), "-o", str(tmp_path / "again")]) == 0
    again = summary_of(tmp_path / "again")["heldout_chi2_noise_only"]
    assert again == pytest.approx(record["noise_only_chi2_after"], rel=1e-3)


@pytest.mark.study
def test_the_report_is_drawn(explained: Path, tmp_path: Path) -> None:
    """The figures of the beam, which take long, are others' to test."""
    for name in ("posterior.h5", "summary.json", "loop.json"):
        shutil.copy(explained / name, tmp_path)
    drop_arrays(tmp_path, *BULK)
    assert main(["report", str(tmp_path)]) == 0
    page = (tmp_path / "report.html").read_text()
    assert "antenna 2" in page.lower()
    assert (tmp_path / "figures" / "loop_ranking.png").exists()


@pytest.mark.study
def test_few_data_are_not_taken_for_noise(tmp_path: Path) -> None:
    """Two times to fit: larger noise is simple, and one antenna's gain still the better explanation once fitted."""
    record = record_of(run_loop(mock_job(GAIN, n_times=4, holdout={"every": 2}), tmp_path))
    assert [one["effect"] for one in record["rounds"]] == ["antenna_gains"]
    assert record["verdict"] == "explained"
    noise = next(one for one in record["rounds"][0]["ranking"] if one["effect"] == "noise_level")
    assert record["rounds"][0]["log_bayes_factor"] > noise["log_bayes_factor"]


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.study) for seed in (1, 2, 3))])
def test_nothing_is_found_in_noise(seed: int, tmp_path: Path) -> None:
    job = mock_job()
    job["seed"] = 100 + seed
    result = run_loop(job, tmp_path)
    record = record_of(result)
    assert record["verdict"] == "consistent"
    assert record["rounds"] == []
    assert record["where"] is None
    assert record["error_before"] == record["error_after"] < 1.5
    assert load_job(result / "amended.toml").effects == ()


def test_what_is_not_explained_is_located(tmp_path: Path) -> None:
    """The one effect that would do is not looked for."""
    job = mock_job(GAIN, loop={"effects": ["timestamp", "antenna_delays", "leakage", "noise_level"]})
    record = record_of(run_loop(job, tmp_path))
    assert record["verdict"] == "unexplained"
    assert record["where"]
    assert record["structures"]
    antennas = record["where"]["antennas"]
    assert antennas["state"] == "concentrated"
    assert [one["what"] for one in antennas["entries"]] == [2]
    assert {one["effect"] for one in record["last_ranking"]} <= {"timestamp", "noise_level"}
    reasons = {one["effect"]: one["reason"] for one in record["skipped"]}
    assert set(reasons) == {"antenna_delays", "leakage"}
    assert "several channels" in reasons["antenna_delays"]
    assert "the files have ee" in reasons["leakage"]


def test_no_round_is_allowed(tmp_path: Path) -> None:
    record = record_of(run_loop(mock_job(GAIN, loop={"max_rounds": 0}), tmp_path))
    assert record["verdict"] == "unexplained"
    assert record["rounds"] == []
    assert record["last_ranking"][0]["effect"] == "antenna_gains"


def test_what_was_found_is_told_on_the_console_at_the_end(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    job = mock_job(GAIN, loop={"effects": ["antenna_gains"], "max_rounds": 1})
    record = record_of(run_loop(job, tmp_path))
    said = capfd.readouterr().err.splitlines()
    told = [f"hydrabeam: {one}" for one in record["said"]]
    assert len(record["rounds"]) == 1
    assert told[-1].startswith("hydrabeam: The model lacked antenna gains;")
    first = said.index(told[0])
    assert said[first : first + len(told)] == told
    rest = said[first + len(told) : -1]
    assert rest == [f"hydrabeam: warning: {one}" for one in record["warnings"] if f"hydrabeam: warning: {one}" in rest]
    assert said[-1].startswith("hydrabeam: wrote ")


def test_what_is_skipped_is_told(tmp_path: Path) -> None:
    job = mock_job(loop={"skip": ["diffuse", "outliers"]})
    record = record_of(run_loop(job, tmp_path))
    reasons = {one["effect"]: one["reason"] for one in record["skipped"]}
    assert reasons["diffuse"] == reasons["outliers"] == "the job says so ([loop] skip)"
    assert reasons.keys() == {"diffuse", "outliers", "antenna_delays", "cable_reflections", "leakage", "spectral_index"}
    weighed = {one["effect"] for one in record["last_ranking"]}
    sought = {kind for kind, effect in EFFECTS.items() if effect.is_sought}
    assert weighed == (sought | {*REWEIGHTINGS}) - reasons.keys()


def test_a_broken_convention_is_named_and_nothing_fitted(explained: Path, tmp_path: Path) -> None:
    uv = UVData.from_file(explained / "data.uvh5")
    uv.data_array = uv.data_array.conj()
    uv.write_uvh5(tmp_path / "conjugated.uvh5")
    job = mock_job()
    job["data"] = {"files": [str(tmp_path / "conjugated.uvh5")]}
    result = run_loop(job, tmp_path)
    record = record_of(result)
    assert record["verdict"] == "convention"
    warning = summary_of(result)["warnings"][0]
    assert warning.startswith("The data follow another convention than the one stated (conjugated): ")
    assert warning.endswith("the inferred beam is not to be used.")
    (told,) = record["rounds"]
    assert told["effect"] == "convention: conjugated"
    assert told.keys() >= ROUND
    assert told["parameters"] == []
    assert record["conventions"]["found"] == "conjugated"
    assert load_job(tmp_path / "result" / "amended.toml").effects == ()


def test_a_loop_that_holds_nothing_out_is_refused(
    comm: MPI.Comm, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    job = mock_job()
    job["holdout"] = {"kind": "none"}
    path = write_job(job, tmp_path)
    assert main(["loop", str(path), "-o", str(tmp_path / "result")]) == 2
    assert f"{path}: [holdout] kind: keeps no data from the fit" in refusal(capfd, comm)
    assert [*tmp_path.iterdir()] == [path]


def test_held_out_data_that_are_all_flagged_are_refused(
    explained: Path, comm: MPI.Comm, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    uv = UVData.from_file(explained / "data.uvh5")
    held = np.unique(uv.time_array)[2::3]
    uv.flag_array[np.isin(uv.time_array, held)] = True
    uv.write_uvh5(tmp_path / "flagged.uvh5")
    job = mock_job(data={"files": [str(tmp_path / "flagged.uvh5")]})
    del job["data"]["simulate"]
    assert main(["loop", str(write_job(job, tmp_path)), "-o", str(tmp_path / "result")]) == 2
    assert f"{tmp_path / 'flagged.uvh5'}: flag_array: all held-out data are flagged" in refusal(capfd, comm)


def test_one_baseline_with_a_flat_prior(explained: Path, tmp_path: Path) -> None:
    """Which tells next to nothing, and no error of its antennas' places along with it."""
    job = mock_job(prior={"kind": "flat"}, basis={"n_modes": 4, "k_max": 4}, loop={"effects": ["antenna_positions"]})
    job["data"] = {"files": [str(explained / "data.uvh5")], "antpairs": [[0, 1]]}
    assert record_of(run_loop(job, tmp_path))["last_ranking"][0]["effect"] == "antenna_positions"


ENTRY = {
    "kind": "antenna_gains",
    "names": ["antenna 2 ln amplitude", "antenna 2 phase"],
    "index": [4, 5],
    "values": [[0.06, -0.05]],
    "prior_std": [0.1, 0.1],
}
NOT_THE_DATA = "use the job as 'hydrabeam loop' wrote it, with the same data, or run the loop again"
COUPLING = {"kind": "cross_coupling", "names": ["x"], "index": [0], "values": [[1.0]], "prior_std": [1.0]}


MISFITS: list[tuple[dict[str, Any], str]] = [
    (
        {**ENTRY, "values": [[0.06, -0.05]] * 2},
        "(antenna_gains): has values for 2 channels, the data have 1; use the job as 'hydrabeam loop' wrote it,"
        " with the same channels",
    ),
    (
        {**ENTRY, "names": ["antenna 77 ln amplitude", "antenna 2 phase"]},
        f"(antenna_gains): is about other antennas, times or sources than the data have; {NOT_THE_DATA}",
    ),
    (
        {**ENTRY, "index": [4, 500]},
        f"(antenna_gains): is about other antennas, times or sources than the data have; {NOT_THE_DATA}",
    ),
    ({**ENTRY, "settings": {"x": 1}}, "(antenna_gains) settings: are not understood; there are channels, as"),
    (
        {**COUPLING, "settings": {"baseline": [[0, 1]]}},
        "(cross_coupling) settings: are not understood; there are baselines, as 'hydrabeam loop' writes them",
    ),
    (
        {**COUPLING, "settings": {"baselines": [[0, 77]]}},
        "(cross_coupling) baselines: no baseline 0-77 in the data; name pairs of antennas that are",
    ),
    (
        {**ENTRY, "kind": "antenna_delays"},
        "(antenna_delays): a delay needs several channels; with one it is a gain phase; remove it",
    ),
    ({**ENTRY, "kind": "leakage"}, "(leakage): cannot be part of the model; remove it"),
    ({"kind": "noise_level", "values": [[1.0, 2.0, 3.0]]}, "(noise_level) values: are not what the data need; "),
    ({"kind": "noise_level", "values": [[-1.0]]}, "(noise_level) values: are not what the data need; "),
    ({"kind": "outliers", "values": [[20.0]]}, "(outliers) values: are not what the data need; "),
]


@pytest.mark.parametrize(
    ("command", "entry", "expected"),
    [(command, *misfit) for command, misfit in zip(cycle(["infer", "loop"]), MISFITS, strict=False)],
)
def test_effects_that_do_not_fit_the_data(
    command: str, entry: dict[str, Any], expected: str, explained: Path, tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    """Which both commands look for in the same place."""
    job = {**mock_job(), "data": {"files": [str(explained / "data.uvh5")]}, "effects": [ENTRY, entry]}
    path = write_job(job, tmp_path)
    assert main([command, str(path), "-o", str(tmp_path / "result")]) == 2
    said = refusal(capfd, MPI.COMM_SELF)
    assert said.startswith(f"hydrabeam: error: {path}: [[effects]] number 2 {expected}")
    assert not (tmp_path / "result").exists()


def test_an_unknown_effect_is_told_those_that_are_known(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = write_job(mock_job(loop={"effects": ["antenna_gain"]}), tmp_path)
    assert main(["loop", str(path), "-o", str(tmp_path / "result")]) == 2
    said = refusal(capfd, MPI.COMM_SELF)
    assert said.startswith(f'hydrabeam: error: {path}: [loop] effects: is "antenna_gain"; it should be ')
    assert all(f"'{kind}'" in said for kind in (*EFFECTS, *REWEIGHTINGS, "leakage"))
    assert said.endswith("did you mean 'antenna_gains'?")
