"""The oracle of the fuzz has teeth, and bites nobody else; its damage is the same at any time."""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import numpy as np
import pytest

from tests.faults.damage import Damage
from tests.faults.damage_hdf5 import HDF5
from tests.faults.oracle import Outcome, lost, misrecorded, nonfinite, silent, state, unclear

LINE = "hydrabeam: error: /a/data.uvh5: freq_array: not ascending; sort them\n"
NAMES = ("data.uvh5", "job.toml")


@pytest.mark.parametrize(
    "outcome",
    [
        Outcome(1, "", "Traceback (most recent call last):\nKeyError: 'x'\n"),
        Outcome(2, "", LINE + LINE),
        Outcome(2, "", ""),
        Outcome(0, "", LINE),
        Outcome(2, "some words\n", LINE),
        Outcome(2, "", LINE + "hydrabeam: wrote it\n"),
        Outcome(2, "", LINE.replace("data.uvh5", "/tmp/x")),
        Outcome(2, "", LINE.replace("sort", "sort " * 500)),
        Outcome(2, "", "HDF5-DIAG: Error detected\n" + LINE),
        Outcome(0, "", "hydrabeam: warning: divide by zero encountered in log\n"),
        Outcome(-11, "", ""),
    ],
)
def test_an_unclear_end_is_told(outcome: Outcome) -> None:
    assert unclear(outcome, NAMES)


@pytest.mark.parametrize("outcome", [Outcome(2, "", LINE), Outcome(0, "words\n", "hydrabeam: warning: flagged\n")])
def test_a_clear_end_is_not(outcome: Outcome) -> None:
    assert unclear(outcome, NAMES) is None


def write_result(folder: Path, number: float) -> None:
    with h5py.File(folder / "posterior.h5", "w") as file:
        file["channel_0000/mean"] = np.array([1.0, number])
        file["channel_0000/none"] = h5py.Empty(float)
    (folder / "summary.json").write_text(json.dumps({"channels": [{"chi2": 1.0}]}))


def test_numbers_that_are_not_finite_are_found(tmp_path: Path) -> None:
    write_result(tmp_path, 2.0)
    assert nonfinite(tmp_path) is None
    write_result(tmp_path, np.inf)
    assert "channel_0000/mean" in str(nonfinite(tmp_path))
    write_result(tmp_path, 2.0)
    (tmp_path / "summary.json").write_text('{"channels": [{"chi2": NaN}]}')
    assert "channels/0/chi2" in str(nonfinite(tmp_path))


def test_illegal_content_may_be_refused_told_of_or_of_no_use() -> None:
    good, other = {"mean": np.array([1.0, 2.0])}, {"mean": np.array([1.0, 2.1])}
    quiet, warned = Outcome(0, "", "hydrabeam: wrote it\n"), Outcome(0, "", "hydrabeam: warning: 3 are flagged\n")
    illegal = Damage("NaN", illegal=True)
    assert silent(illegal, quiet, other, good, 0)
    assert silent(illegal, warned, other, good, 1)
    assert silent(illegal, warned, other, good, 0) is None
    assert silent(illegal, quiet, good, good, 0) is None
    assert silent(Damage("another number"), quiet, other, good, 0) is None


def test_what_is_gone_changed_or_left_is_told(tmp_path: Path) -> None:
    for name in ("one", "two"):
        (tmp_path / name).write_text(name)
    before = state(tmp_path)
    (tmp_path / "out").mkdir()
    assert lost(before, state(tmp_path), ("out",)) is None
    assert "left behind: out" in str(lost(before, state(tmp_path), ()))
    (tmp_path / "two").write_text("changed")
    assert "changed: two" in str(lost(before, state(tmp_path), ("out",)))
    (tmp_path / "one").unlink()
    assert "gone: one" in str(lost(before, state(tmp_path), ("out",)))


def test_a_wrong_checksum_is_told(tmp_path: Path) -> None:
    file = tmp_path / "data.uvh5"
    file.write_bytes(b"1")
    (tmp_path / "provenance.json").write_text(json.dumps({"sha256": {str(file): "0"}}))
    assert "checksum" in str(misrecorded(tmp_path, file))


@pytest.mark.parametrize("number", range(len(HDF5)))
def test_damage_is_the_same_at_any_time(tmp_path: Path, number: int) -> None:
    said = []
    for name in ("a", "b"):
        path = tmp_path / f"{name}.h5"
        with h5py.File(path, "w") as file:
            file["Header/time_array"], file["covariance"] = np.arange(4.0), np.eye(2)
            file.attrs["basis"] = "{}"
        said.append(HDF5[number](path, np.random.default_rng(number)))
    assert said[0] == said[1]
