"""What a page says in words."""

from __future__ import annotations

import pytest

from hydrabeam_mpi.report.page.words import _holdout, _origin

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
