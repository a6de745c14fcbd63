"""What a page says in words."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import tomli_w

from hydrabeam_mpi.cli import main
from hydrabeam_mpi.report.page.result import load_result
from hydrabeam_mpi.report.page.words import _holdout, _origin, _prior, introduction
from tests.report.conftest import PAPER

READ = {"/data/a.uvh5": "1", "/data/b.uvh5": "2", "/data/[x].uvh5": "3", "/models/beam.fits": "4"}


@pytest.mark.parametrize(
    ("files", "words"),
    [
        (["/data/a.uvh5"], "were read from 1 file"),
        (["/data/[ab].uvh5"], "were read from 2 files"),
        (["/data/[[]x].uvh5", "/data/a*"], "were read from 2 files"),
        (["/moved/elsewhere.uvh5"], "were read from 1 file"),
        ([], "were measured"),
    ],
)
def test_files_behind_wildcards_are_counted(files: list[str], words: str) -> None:
    assert _origin({"files": files}, READ) == words


@pytest.mark.parametrize(
    ("every", "words"), [(2, "every second time"), (3, "every third time"), (21, "one time in 21")]
)
def test_how_often_a_time_is_held_out(every: int, words: str) -> None:
    assert _holdout({"holdout": {"kind": "times", "every": every}}) == (
        f" To test it, {words} was held out of the inference."
    )


def test_widths_that_the_data_chose_are_told_and_all_functions_in_plain_words(tmp_path: Path) -> None:
    basis, prior = {"n_modes": 40, "rest": True}, {"widths": "evidence"}
    (tmp_path / "job.toml").write_text(tomli_w.dumps(PAPER | {"basis": basis, "prior": prior}))
    assert main(["infer", str(tmp_path / "job.toml"), "-o", str(tmp_path / "result")]) == 0
    adapted = json.loads((tmp_path / "result" / "summary.json").read_text())["prior_adapted"]
    said = introduction(load_result(tmp_path / "result"))
    assert "a sum of 40 Fourier-Bessel modes and what the model beam has beyond them, with real coefficients" in said
    assert f"with standard deviations that these data chose: {100 * adapted['fraction']:.3g}% of " in said
    assert f"{100 * adapted['smooth']['amplitude']:.3g}% of the largest of all at the lowest orders" in said
    assert "100% of each coefficient" not in said


def test_a_result_as_prior_is_told() -> None:
    assert (
        _prior({"prior": {"kind": "file", "file": "/runs/first"}}, {})
        == "; its prior is the result first of other data."
    )
    assert "the covariance of beams.npz" in _prior({"prior": {"kind": "file", "file": "beams.npz"}}, {})
