"""What a page says in words."""

from __future__ import annotations

import pytest

from hydrabeam_mpi.report.page.words import _origin

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
