from __future__ import annotations

import hashlib
import json
import platform
import re
from importlib.metadata import version
from pathlib import Path

import tomli_w

from hydrabeam_mpi.config import load_job
from hydrabeam_mpi.io.provenance import PACKAGES, provenance


def test_provenance_says_what_made_a_result(tmp_path: Path) -> None:
    path, data = tmp_path / "job.toml", tmp_path / "a.uvh5"
    path.write_text("seed = 5\n[data]\nfiles = ['a.uvh5']\n")
    data.write_bytes(b"visibilities")
    job = load_job(path)
    about = provenance(job, [data], ranks=3, threads=2, mpi="some MPI 1.2")
    # As JSON keeps it.
    about = json.loads(json.dumps(about))
    assert about["sha256"] == {str(data): hashlib.sha256(b"visibilities").hexdigest()}
    assert about["ranks"] == 3
    assert about["threads_per_rank"] == 2
    assert about["versions"]["mpi"] == "some MPI 1.2"
    assert about["versions"]["python"] == platform.python_version()
    assert about["versions"]["numpy"] == version("numpy")
    assert all(re.match(r"\d", about["versions"][package]) for package in PACKAGES)
    path.write_text(tomli_w.dumps(about["job"]))
    assert load_job(path) == job
