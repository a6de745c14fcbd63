"""The program as a user meets it: help, normal runs, and runs that are ended from outside."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable
from pathlib import Path
from subprocess import CompletedProcess

import numpy as np
import pytest
from astropy import units
from astropy.coordinates import SkyCoord
from mpi4py import MPI
from pyradiosky import SkyModel

from hydrabeam_mpi.cli import main
from hydrabeam_mpi.config import load_job
from hydrabeam_mpi.io.posterior_file import read_posterior
from tests.cli.conftest import OnRoot, Workspace
from tests.launched import environment, passed_on

Runner = Callable[..., CompletedProcess[str]]
PROGRAM = (sys.executable, "-m", "hydrabeam_mpi")


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--help"], ["simulate", "infer", "report", "init", "mpiexec"]),
        (["infer", "--help"], ["JOB.toml", "-o", "--overwrite"]),
        (["simulate", "--help"], ["JOB.toml", "-o", "--overwrite", "data.uvh5"]),
        (["report", "--help"], ["DIR"]),
        (["init", "--help"], ["FILE", "-o"]),
        (["--version"], ["hydrabeam_mpi "]),
    ],
    ids=" ".join,
)
def test_help(words: list[str], said: list[str], comm: MPI.Comm, capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="0"):
        main(words)
    out, err = capfd.readouterr()
    assert not err
    assert all(word in out for word in said) if comm.rank == 0 else not out


def test_help_is_said_once(mpiexec: Runner) -> None:
    result = mpiexec(2, *PROGRAM, "infer", "--help")
    assert result.returncode == 0
    assert not result.stderr
    assert result.stdout.count("usage: hydrabeam infer") == 1


def test_help_is_quick() -> None:
    source = """
import resource, sys
from hydrabeam_mpi.cli import main
try:
    main(["--help"])
finally:
    spent = resource.getrusage(resource.RUSAGE_SELF)
    print(spent.ru_utime + spent.ru_stime, file=sys.stderr)
"""
    result = subprocess.run([sys.executable, "-c", source], capture_output=True, text=True, check=True)
    # Processor seconds: other work on the machine stretches those on the wall.
    assert float(result.stderr) < 1.5


@pytest.mark.mpi
def test_normal_run_says_only_its_own_lines(
    workspace: Workspace, on_root: OnRoot, comm: MPI.Comm, capfd: pytest.CaptureFixture[str]
) -> None:
    job = on_root(lambda: workspace.simulation())
    capfd.readouterr()
    assert main(["infer", str(job), "-o", str(workspace.folder / "result")]) == 0
    out, err = capfd.readouterr()
    assert not out
    if comm.rank > 0:
        assert not err
        return
    said = err.splitlines()
    assert all(re.match("hydrabeam: (?!error)", line) for line in said)
    warnings = json.loads((workspace.folder / "result" / "summary.json").read_text())["warnings"]
    assert [line for line in said if "warning" in line] == [f"hydrabeam: warning: {one}" for one in warnings]
    *_, told, last = (line for line in said if "warning" not in line)
    assert last == f"hydrabeam: wrote {workspace.folder / 'result'}"
    assert re.match(r"hydrabeam: 131 MHz: held-out rms \S+ Jy \(noise \S+, model beam \S+ Jy\), reduced chi\^2", told)
    assert {path.name for path in (workspace.folder / "result").iterdir()} == {
        "beam.beamfits", "data.uvh5", "job.toml", "manifest.json", "posterior.h5", "provenance.json", "summary.json",
        "truth.h5",
    }  # fmt: skip
    assert {path.name for path in workspace.folder.iterdir()} == {"job.toml", "result"}


def test_dry_run_says_what_it_would_take_and_writes_nothing(
    workspace: Workspace, capfd: pytest.CaptureFixture[str]
) -> None:
    job, out = workspace.job(), workspace.folder / "result"
    # A process of its own: the forecast counts what the process has needed so far.
    command = [*PROGRAM, "infer", str(job), "-o", str(out), "--dry-run"]
    result = subprocess.run(command, capture_output=True, text=True, check=True, env=environment())
    assert re.search(r"^infer +1 +\d.* (s|min) +\d+ MB", result.stdout, re.MULTILINE)
    last = result.stderr.splitlines()[-1]
    assert last == f"hydrabeam: nothing has been done; without --dry-run, infer would write {out}"
    assert {path.name for path in workspace.folder.iterdir()} == {"job.toml"}
    # What is in the way is told as it would be.
    out.mkdir()
    assert main(["infer", str(job), "-o", str(out), "--dry-run"]) == 2
    assert "result: -o: exists already" in capfd.readouterr().err


@pytest.mark.mpi
def test_notes_are_said_once(
    workspace: Workspace, on_root: OnRoot, comm: MPI.Comm, capfd: pytest.CaptureFixture[str]
) -> None:
    on_root(lambda: write_catalogue(workspace.folder / "sky.skyh5", flux=[10.0, -1.0, 20.0]))
    job = on_root(lambda: workspace.job({"sky.n_sources": None, "sky.kind": "catalogue", "sky.file": "sky.skyh5"}))
    capfd.readouterr()
    assert main(["infer", str(job), "-o", str(workspace.folder / "result")]) == 0
    notes = [line for err in comm.allgather(capfd.readouterr().err) for line in err.splitlines() if "sky.skyh5" in line]
    assert notes == [
        "hydrabeam: sky.skyh5 gives one flux a source, used at every frequency",
        "hydrabeam: warning: sky.skyh5: 1 of 3 sources left out: 0 without a flux or place, the others not positive",
    ]


def write_catalogue(path: Path, flux: list[float]) -> None:
    stokes = np.zeros((4, 1, len(flux)))
    stokes[0] = flux
    SkyModel(
        name=[f"source {i}" for i in range(len(flux))],
        skycoord=SkyCoord(np.full(len(flux), 95.0) * units.deg, np.full(len(flux), -30.0) * units.deg, frame="icrs"),
        stokes=stokes * units.Jy,
        spectral_type="flat",
    ).write_skyh5(path)


def test_installed_program_on_one_and_two_ranks(workspace: Workspace, mpiexec: Runner) -> None:
    job = workspace.job()
    for ranks in (1, 2):
        result = mpiexec(ranks, *PROGRAM, "infer", job, "-o", workspace.folder / f"on{ranks}")
        assert result.returncode == 0, result.stderr
        assert not result.stdout
        assert all(line.startswith("hydrabeam: ") for line in result.stderr.splitlines())
        assert result.stderr.count("hydrabeam: wrote") == 1
    one, two = (read_posterior(workspace.folder / f"on{ranks}" / "posterior.h5").channels[0] for ranks in (1, 2))
    np.testing.assert_allclose(two.arrays["mean"], one.arrays["mean"], atol=1e-8 * one.arrays["std"].min())


@pytest.mark.parametrize("ranks", [pytest.param(1, marks=pytest.mark.study), 2])
def test_installed_program_refuses(ranks: int, workspace: Workspace, mpiexec: Runner) -> None:
    job = workspace.job({"data.polarization": "nn", "beam.source": "airy", "beam.diameter": 14.0})
    result = mpiexec(ranks, *PROGRAM, "infer", job, "-o", workspace.folder / "result")
    assert result.returncode == 2
    assert not result.stdout
    assert "Traceback" not in result.stderr
    complaints = [line for line in result.stderr.splitlines() if "error" in line]
    assert len(complaints) == 1
    assert complaints[0].startswith(f"hydrabeam: error: {workspace.data}: polarization_array: ")
    assert sorted(path.name for path in workspace.folder.iterdir()) == ["job.toml"]


@pytest.mark.mpi
def test_resolved_job_gives_the_same_result(
    result: Path, workspace: Workspace, on_root: OnRoot, comm: MPI.Comm
) -> None:
    resolved = result / "job.toml"
    assert load_job(resolved) == load_job(result.parent / "job.toml")
    again = workspace.folder / "again"
    assert main(["infer", str(resolved), "-o", str(again)]) == 0
    first, second = (read_posterior(folder / "posterior.h5").channels[0].arrays for folder in (result, again))
    np.testing.assert_array_equal(second["mean"], first["mean"])
    np.testing.assert_array_equal(second["draws"], first["draws"])
    provenance = json.loads((result / "provenance.json").read_text())
    assert provenance["job"] == tomllib.loads(resolved.read_text())
    assert list(provenance["sha256"]) == [str(workspace.data)]


@pytest.mark.mpi
def test_overwrite_replaces_only_by_a_whole_result(
    workspace: Workspace, on_root: OnRoot, capfd: pytest.CaptureFixture[str]
) -> None:
    out = workspace.folder / "result"
    good, bad = (
        on_root(lambda: workspace.simulation(name="good.toml")),
        on_root(lambda: workspace.simulation({"holdout.every": 9}, "bad.toml")),
    )
    assert main(["simulate", str(good), "-o", str(out)]) == 0
    before = on_root(lambda: (out / "provenance.json").read_bytes())
    # Fails after the data have been simulated.
    assert main(["infer", str(bad), "-o", str(out), "--overwrite"]) == 2
    assert on_root(lambda: (out / "provenance.json").read_bytes()) == before
    assert main(["infer", str(good), "-o", str(out), "--overwrite"]) == 0
    assert on_root(lambda: (out / "posterior.h5").exists())
    assert on_root(lambda: sorted(path.name for path in workspace.folder.iterdir())) == [
        "bad.toml",
        "good.toml",
        "result",
    ]


@pytest.mark.parametrize(
    ("how", "ranks"),
    [
        (signal.SIGINT, 1),
        pytest.param(signal.SIGINT, 2, marks=[passed_on, pytest.mark.study]),
        pytest.param(signal.SIGTERM, 2, marks=passed_on),
        (signal.SIGKILL, 1),
    ],
    ids=["Ctrl-C", "Ctrl-C on 2 ranks", "SIGTERM on 2 ranks", "SIGKILL"],
)
def test_a_run_that_is_ended_keeps_the_earlier_result(
    how: signal.Signals, ranks: int, workspace: Workspace, mpiexec: Runner
) -> None:
    out = workspace.folder / "result"
    assert main(["simulate", str(workspace.simulation()), "-o", str(out)]) == 0
    before = (out / "provenance.json").read_bytes()
    job = workspace.simulation({"data.simulate.n_times": 20000, "sky.n_sources": 20000}, "long.toml")
    command = [*(["mpiexec", "-n", str(ranks)] if ranks > 1 else []), *PROGRAM, "infer", job, "-o", out, "--overwrite"]
    given = {"stdin": subprocess.DEVNULL, "stderr": subprocess.PIPE, "env": environment()}
    with subprocess.Popen(command, text=True, **given) as process:
        wait_for(lambda: any(".result.partial-" in path.name for path in workspace.folder.iterdir()))
        time.sleep(0.5)
        process.send_signal(how)
        _, err = process.communicate(timeout=300)
    assert process.returncode != 0
    assert "Traceback" not in err
    assert (out / "provenance.json").read_bytes() == before
    if how != signal.SIGKILL:  # which leaves no time to clean up
        wait_for(lambda: {path.name for path in workspace.folder.iterdir()} == {"job.toml", "long.toml", "result"})
    if how != signal.SIGKILL:
        assert process.returncode == 130
        assert err.splitlines().count("hydrabeam: interrupted") == 1


def wait_for(condition: Callable[[], bool], seconds: float = 300.0) -> None:
    """Wait for what must happen; the time, long enough on a busy machine, only ends a test that would wait forever."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)
