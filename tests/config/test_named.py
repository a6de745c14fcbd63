from __future__ import annotations

import os
from pathlib import Path

import pytest

from hydrabeam_mpi.config import Job, load_job
from hydrabeam_mpi.config.named import expand, named_files, simulation_files
from hydrabeam_mpi.errors import InputError

FILES = """
[data]
files = ["night*.uvh5", "data.ms"]
gains = ["gains.calfits"]
[noise]
kind = "file"
file = "noise.npz"
[sky]
kind = "catalogue"
file = "gleam.vot"
diffuse = "gsm"
[beam]
source = "beam.fits"
[prior]
kind = "file"
file = "prior.h5"
"""
FOLDERS = ("data.ms", "gsm")
DATA = ("night1.uvh5", "night2.uvh5", "data.ms", "gains.calfits")
MODELS = ("gleam.vot", "gsm", "beam.fits")
NAMES = (*DATA, *MODELS, "noise.npz", "prior.h5")


def load(folder: Path, text: str) -> Job:
    (folder / "job.toml").write_text(text)
    return load_job(folder / "job.toml")


@pytest.fixture
def job(tmp_path: Path) -> Job:
    """A job all of whose files are there."""
    for name in NAMES:
        (tmp_path / name).mkdir() if name in FOLDERS else (tmp_path / name).touch()
    return load(tmp_path, FILES)


def test_all_that_a_job_names(job: Job, tmp_path: Path) -> None:
    assert named_files(job) == [tmp_path / name for name in NAMES]
    assert simulation_files(job) == [tmp_path / name for name in MODELS]


def test_layout_of_a_simulation(tmp_path: Path) -> None:
    job = load(tmp_path, "[data.simulate]\narray = { file = 'layout.csv' }\n")
    with pytest.raises(InputError, match=r"layout.csv: \[data.simulate.array\] file: no such file; check the path"):
        named_files(job)
    (tmp_path / "layout.csv").touch()
    assert named_files(job) == [tmp_path / "layout.csv"]


@pytest.mark.parametrize(
    ("name", "field"),
    [
        ("data.ms", "[data] files"),
        ("gains.calfits", "[data] gains"),
        ("gleam.vot", "[sky] file"),
        ("gsm", "[sky] diffuse"),
        ("beam.fits", "[beam] source"),
        ("noise.npz", "[noise] file"),
        ("prior.h5", "[prior] file"),
    ],
)
@pytest.mark.parametrize("what", ["missing", "loop", "other kind", "pipe"])
def test_what_is_not_there_or_not_as_it_should_be(name: str, field: str, what: str, job: Job, tmp_path: Path) -> None:
    path = tmp_path / name
    either = name in ("data.ms", "noise.npz", "prior.h5")
    path.rmdir() if path.is_dir() else path.unlink()
    if what == "loop":
        path.symlink_to(path)
    elif what == "pipe":
        os.mkfifo(path)
    elif what == "other kind" and name in FOLDERS:
        path.touch()
    elif what == "other kind":
        path.mkdir()
    if what == "other kind" and either:
        assert path in named_files(job)
        return
    words = {
        "missing": "no such file",
        "loop": "cannot be read (Too many levels of symbolic links)",
        "other kind": "is a file, not a folder" if name in FOLDERS else "is a folder, not a file",
        "pipe": "is neither a file nor a folder",
    }[what]
    with pytest.raises(InputError) as raised:
        named_files(job)
    assert str(raised.value).startswith(f"{path}: {field}: {words}; check the path")


def test_patterns(tmp_path: Path) -> None:
    for name in ("b1.uvh5", "a2.uvh5", "a1.uvh5", "c[1].uvh5"):
        (tmp_path / name).touch()
    patterns = [f"{tmp_path}/b*", f"{tmp_path}/a*", f"{tmp_path}/a1.uvh5", f"{tmp_path}/c[1].uvh5"]
    found = [path.name for path in expand(patterns, "[data] files")]
    assert found == ["b1.uvh5", "a1.uvh5", "a2.uvh5", "c[1].uvh5"]
    with pytest.raises(InputError, match=r"d\*: \[data\] files: no such file"):
        expand([f"{tmp_path}/d*"], "[data] files")


@pytest.mark.parametrize("folder", ["run [1]", "what?", "all*"])
def test_a_folder_is_no_pattern(folder: str, tmp_path: Path) -> None:
    """One of a name that is a pattern stands for itself; jobs in it find their files."""
    for name in (folder, "run 1", "whats", "all of it"):
        (tmp_path / name / "night1").mkdir(parents=True)
        (tmp_path / name / "night1" / "a.uvh5").touch()
    (tmp_path / folder / "job.toml").write_text(
        "[data]\nfiles = ['night?/*.uvh5']\n[beam]\nsource = 'airy'\ndiameter = '14 m'\n"
    )
    job = load_job(tmp_path / folder / "job.toml")
    assert expand(job.data.files, "[data] files") == (tmp_path / folder / "night1" / "a.uvh5",)
    with pytest.raises(InputError, match=r"\*\.ms: \[data\] files: no such file"):
        expand([f"{tmp_path / folder}/*.ms"], "[data] files")


@pytest.mark.parametrize("name", ["a\0b.uvh5", "n" * 300])
def test_what_is_no_name_of_a_file(name: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"cannot be read \((embedded null byte|File name too long)\)"):
        expand([f"{tmp_path}/{name}"], "[data] files")


@pytest.mark.skipif(os.geteuid() == 0, reason="nothing is forbidden to root")
def test_what_may_not_be_read(job: Job, tmp_path: Path) -> None:
    (tmp_path / "gleam.vot").chmod(0)
    with pytest.raises(InputError, match=r"gleam.vot: \[sky\] file: cannot be read \(Permission denied\)"):
        named_files(job)
