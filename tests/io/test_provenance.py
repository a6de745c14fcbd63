from __future__ import annotations

import hashlib
import json
import platform
import re
import subprocess
from importlib.metadata import version
from pathlib import Path

import tomli_w

from hydrabeam_mpi.config import load_job
from hydrabeam_mpi.io.provenance import PACKAGES, checksum, provenance


def test_checksum_of_a_file_is_that_of_sha256sum(tmp_path: Path) -> None:
    path = tmp_path / "a"
    # Longer than what is read at once, and not a multiple of it.
    path.write_bytes(bytes(range(256)) * (5 * 2**22 // 512) + b"end")
    said = subprocess.run(["sha256sum", path], capture_output=True, text=True, check=True).stdout
    assert checksum(path) == said.split()[0]


def test_checksum_of_a_folder_is_that_of_its_files_in_order(tmp_path: Path) -> None:
    folder = tmp_path / "data.ms"
    (folder / "table").mkdir(parents=True)
    (folder / "empty").mkdir()
    parts = {"table/b": b"second", "a": b"first", "table/c": b"third"}
    for name, part in parts.items():
        (folder / name).write_bytes(part)
    assert checksum(folder) == hashlib.sha256(b"firstsecondthird").hexdigest()
    (folder / "table" / "b").write_bytes(b"changed")
    assert checksum(folder) != hashlib.sha256(b"firstsecondthird").hexdigest()


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
