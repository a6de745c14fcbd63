"""Runs whose disk is too small, whose data change under them, and that come after one that was killed."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from hydrabeam_mpi.cli import main
from tests.cli.conftest import Workspace

PROGRAM = (sys.executable, "-m", "hydrabeam_mpi")


@pytest.mark.parametrize("command", ["simulate", "infer", "loop"])
def test_a_small_disk_is_told_before_the_work(
    command: str, small_disk: Path, workspace: Workspace, capfd: pytest.CaptureFixture[str]
) -> None:
    many = {"data.simulate.n_times": 2000} if command == "simulate" else {}
    job = workspace.simulation(many)
    assert main([command, str(job), "-o", str(small_disk / "result")]) == 2
    (*_, line) = capfd.readouterr().err.splitlines()
    assert line.startswith(f"hydrabeam: error: {small_disk}: -o: needs at least ")
    assert line.endswith("B left; make room, or choose a folder elsewhere")
    assert [*small_disk.iterdir()] == []


def test_a_path_is_looked_at_before_the_heavy_imports(workspace: Workspace) -> None:
    job = workspace.job({"prior.kind": "file", "prior.file": "missing.h5"})
    source = f"""
import sys
from hydrabeam_mpi.cli import main
assert main(["infer", {str(job)!r}, "-o", {str(workspace.folder / "result")!r}]) == 2
assert not {{"astropy", "h5py", "pyuvdata", "scipy"}} & set(sys.modules)
"""
    ended = subprocess.run([sys.executable, "-c", source], capture_output=True, text=True, check=True)
    expected = f"hydrabeam: error: {workspace.folder / 'missing.h5'}: [prior] file: no such file; check the path\n"
    assert ended.stderr == expected


def test_data_that_go_during_the_run(workspace: Workspace) -> None:
    layout = workspace.folder / "layout.csv"
    layout.write_text("E,N,U\n0,0,0\n14,1,0\n2,20,0\n")
    job = workspace.simulation({"data.simulate.array": {"file": layout.name}})
    out = workspace.folder / "result"
    with subprocess.Popen([*PROGRAM, "infer", job, "-o", out], stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr
        wait_for(process.stderr.readline, "reading metadata")
        layout.unlink()
        _, err = process.communicate(timeout=300)
    assert process.returncode == 2
    (partial,) = workspace.folder.glob(".result.partial-*")
    assert err.splitlines()[-1].startswith(f"hydrabeam: error: {layout}: was removed during the run")
    assert err.endswith(f"; the result is kept in {partial}\n")
    assert (partial / "posterior.h5").exists()
    assert not out.exists()


def test_what_a_killed_run_left_is_removed_by_the_next(workspace: Workspace, capfd: pytest.CaptureFixture[str]) -> None:
    job = workspace.simulation({"data.simulate.n_times": 20000, "sky.n_sources": 20000}, "long.toml")
    out = workspace.folder / "result"
    with subprocess.Popen([*PROGRAM, "infer", job, "-o", out], stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr
        wait_for(process.stderr.readline, "simulating")
        process.send_signal(signal.SIGKILL)
        process.communicate(timeout=300)
    (partial,) = workspace.folder.glob(".result.partial-*")
    capfd.readouterr()
    assert main(["infer", str(workspace.simulation()), "-o", str(out)]) == 0
    said = capfd.readouterr().err.splitlines()
    assert said.count(f"hydrabeam: removed {partial}, which a run that was killed had left") == 1
    assert {path.name for path in workspace.folder.iterdir()} == {"job.toml", "long.toml", "result"}


def wait_for(line: Callable[[], str], word: str, seconds: float = 300.0) -> None:
    deadline = time.monotonic() + seconds
    while word not in line():
        assert time.monotonic() < deadline
