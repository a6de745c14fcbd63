"""A loop that is ended keeps the rounds that have ended, and the same command goes on from there to the same record."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from hydrabeam_mpi.cli import main
from hydrabeam_mpi.io.kept_rounds import latest_round
from tests.cli.conftest import refusal
from tests.launched import environment, passed_on
from tests.loop.mock import mock_job, write_job
from tests.loop.test_loop_command import GAIN, TWO, channels_of, record_of
from tests.loop.test_loop_ranks import assert_alike

MISSING = {
    "kind": "missing_sources",
    "settings": {"sources": [[31.37, -28.64]]},
    "parameters": {"source at ra=31.370 dec=-28.640: flux": 3.0},
}
"""Found in a round of its own: the linear model does not tell where it is, so that it is in no set with the gain."""
LOOP = {"effects": ["antenna_gains", "missing_sources", "outliers"], "max_rounds": 2}
JOB = mock_job(GAIN, MISSING, freqs=TWO, n_times=8, loop=LOOP)
HELD = """
import io, os, sys, time
from hydrabeam_mpi.cli import main

class Held(io.TextIOWrapper):
    told = False

    def write(self, text):
        self.told = self.told or text.startswith(os.environ["HELD_AT"])
        return super().write(text)

    def flush(self):
        told, self.told = self.told, False
        super().flush()
        if told:
            time.sleep(600)

sys.stderr = Held(sys.stderr.buffer)
sys.exit(main(sys.argv[1:]))
"""
"""The program, which waits for a signal where it says something, as nobody can tell how long what comes then takes."""


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The result of a loop that nobody has ended."""
    folder = tmp_path_factory.mktemp("whole")
    assert main(["loop", str(write_job(JOB, folder)), "-o", str(folder / "result")]) == 0
    assert len(record_of(folder / "result")["rounds"]) == 2
    return folder / "result"


def end(
    folder: Path, number: signal.Signals, n_ranks: int = 1, held_at: str = "hydrabeam: round 2:"
) -> tuple[int, list[str]]:
    """Run a loop and end it, in its second round or elsewhere; return the exit status and what it has said since."""
    launcher = ["mpiexec", "-n", str(n_ranks)] if n_ranks > 1 else []
    words = [*launcher, sys.executable, "-c", HELD, "loop", folder / "job.toml", "-o", folder / "result"]
    given = environment(OMP_NUM_THREADS="1", HELD_AT=held_at)
    with subprocess.Popen(words, stderr=subprocess.PIPE, text=True, start_new_session=True, env=given) as process:
        assert process.stderr is not None
        for line in process.stderr:
            if line.startswith(held_at):
                break
        os.kill(process.pid, number)
        said = process.stderr.read().splitlines()
    return process.returncode, said


def assert_goes_on(folder: Path, whole: Path, capfd: pytest.CaptureFixture[str], after: str = "1 round(s)") -> None:
    capfd.readouterr()
    assert main(["loop", str(folder / "job.toml"), "-o", str(folder / "result")]) == 0
    assert_has_gone_on(folder, whole, capfd.readouterr().err, after)
    one, two = record_of(whole), record_of(folder / "result")
    assert two.pop("seconds")["trials"] > 0
    one.pop("seconds")
    assert two == one
    for first, second in zip(channels_of(whole), channels_of(folder / "result"), strict=True):
        np.testing.assert_array_equal(first["mean"], second["mean"])
        np.testing.assert_array_equal(first["covariance"], second["covariance"])


def assert_has_gone_on(folder: Path, whole: Path, said: str, after: str = "1 round(s)") -> None:
    assert f"going on after {after} of an earlier run" in said
    assert ("round 1:" in said) == (after != "1 round(s)")
    assert sorted(path.name for path in folder.iterdir()) == ["job.toml", "result"]
    assert {path.name for path in (folder / "result").iterdir()} == {path.name for path in whole.iterdir()}


@pytest.fixture(scope="module")
def interrupted_once(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("interrupted")
    write_job(JOB, folder)
    assert end(folder, signal.SIGINT)[0] == 130
    return folder


@pytest.fixture
def interrupted(interrupted_once: Path, tmp_path: Path) -> Path:
    """A folder with a job, and the result of its loop, which was interrupted in the second round."""
    shutil.copytree(interrupted_once, tmp_path, dirs_exist_ok=True)
    return tmp_path


def test_what_is_interrupted_says_so_and_goes_on(
    interrupted: Path, whole: Path, comm: MPI.Comm, capfd: pytest.CaptureFixture[str]
) -> None:
    result = interrupted / "result"
    record = record_of(result)
    assert record["verdict"] == "interrupted"
    told, expected = record["rounds"][0], record_of(whole)["rounds"][0]
    assert (told["effect"], told["log_bayes_factor"]) == (expected["effect"], expected["log_bayes_factor"])
    assert [path.name for path in (result / "rounds").iterdir()] == ["0001"]
    before = write_job({**JOB, "prior": {"file": str(result)}}, interrupted / "other")
    uses = [["report", result], ["infer", before], ["correct", result], ["predict", result, interrupted / "job.toml"]]
    for number, words in enumerate(uses):
        out = ["-o", str(interrupted / "other" / f"out{number}")] if number else []
        assert main([*map(str, words), *out]) == 2
        assert f"{result}: is of a loop that was interrupted" in refusal(capfd, comm)
    # Another job does not take its place.
    other = write_job({**JOB, "seed": 5}, interrupted / "other")
    assert main(["loop", str(other), "-o", str(result)]) == 2
    assert f"{result}: -o: exists already" in refusal(capfd, comm)
    other.unlink()
    other.parent.rmdir()
    assert_goes_on(interrupted, whole, capfd)


@pytest.mark.study
def test_what_is_interrupted_in_the_first_round_leaves_what_is_known(
    whole: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """The first fit, and what was weighed; nothing of it is fitted twice."""
    write_job(JOB, tmp_path)
    status, said = end(tmp_path, signal.SIGTERM, held_at="hydrabeam:   trying")
    assert status == 130
    kept = f"kept in {tmp_path / 'result'}: the fit before the first round, from where the same command goes on"
    assert said[0] == f"hydrabeam: {kept}"
    record, expected = record_of(tmp_path / "result"), record_of(whole)
    assert (record["verdict"], record["rounds"]) == ("interrupted", [])
    assert record["error_before"] == record["error_after"] == expected["error_before"]
    first = expected["rounds"][0]["ranking"]
    assert record["last_ranking"] == first
    assert record["health"] == expected["health"]
    assert f"Weighed, but not yet fitted: {first[0]['effect'].replace('_', ' ')} (log" in record["sentence"]
    assert_goes_on(tmp_path, whole, capfd, "the fit before the first round")


def test_a_damaged_round_is_told(interrupted: Path, comm: MPI.Comm, capfd: pytest.CaptureFixture[str]) -> None:
    kept = latest_round(interrupted / "result")
    assert kept is not None
    history = kept / "course.object"
    content = bytearray(history.read_bytes())
    content[len(content) // 2] ^= 1
    history.write_bytes(content)
    before = sorted(interrupted.rglob("*"))
    assert main(["loop", str(interrupted / "job.toml"), "-o", str(interrupted / "result")]) == 2
    said = refusal(capfd, comm)
    assert "holds what the earlier result did not" in said
    assert "course.object (changed)" in said
    assert sorted(interrupted.rglob("*")) == before


@passed_on
@pytest.mark.parametrize(("number", "then_on"), [(signal.SIGINT, 3), (signal.SIGTERM, 1)])
@pytest.mark.study
def test_signals_to_the_launcher(
    number: signal.Signals, then_on: int, whole: Path, tmp_path: Path, mpiexec: Any
) -> None:
    """Which passes them on to all ranks, wherever these are; the loop then goes on with any number of ranks."""
    write_job(JOB, tmp_path)
    status, said = end(tmp_path, number, n_ranks=2)
    assert status == 130
    assert said[:2] == [
        f"hydrabeam: kept in {tmp_path / 'result'}: 1 round(s), from where the same command goes on",
        "hydrabeam: interrupted",
    ]
    assert record_of(tmp_path / "result")["verdict"] == "interrupted"
    words = [sys.executable, "-m", "hydrabeam_mpi", "loop", tmp_path / "job.toml", "-o", tmp_path / "result"]
    done = mpiexec(then_on, *words, timeout=300)
    assert done.returncode == 0, done.stderr
    assert_has_gone_on(tmp_path, whole, done.stderr)
    assert_alike(record_of(whole), record_of(tmp_path / "result"), "")
    for one, other in zip(channels_of(whole), channels_of(tmp_path / "result"), strict=True):
        assert np.all(np.abs(other["mean"] - one["mean"]) < 1e-5 * one["std"])
        np.testing.assert_allclose(other["std"], one["std"], rtol=1e-6)


def test_what_is_killed_goes_on(whole: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    write_job(JOB, tmp_path)
    assert end(tmp_path, signal.SIGKILL) == (-signal.SIGKILL, [])
    (partial,) = tmp_path.glob(".result.partial-*")
    # A run of another job leaves it where it is.
    other = write_job({**JOB, "seed": 5, "loop": {"max_rounds": 0}}, tmp_path, "other.toml")
    assert main(["loop", str(other), "-o", str(tmp_path / "result")]) == 0
    assert f"{partial} has rounds of another job, whose run was killed: they stay there" in capfd.readouterr().err
    for path in [other, *(tmp_path / "result").iterdir()]:
        path.unlink()
    (tmp_path / "result").rmdir()
    assert_goes_on(tmp_path, whole, capfd)
