"""Fixtures for all tests, and what a run under mpiexec needs."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from mpi4py import MPI

from tests.agreement import RankAgreement
from tests.launched import environment

REPOSITORY = Path(__file__).parents[1]

if MPI.COMM_WORLD.size > 1:
    # Before the first BLAS is loaded: the ranks of a test share very few cores.
    os.environ.setdefault("OMP_NUM_THREADS", "1")


@pytest.hookimpl(trylast=True)
def pytest_configure(config: pytest.Config) -> None:
    if MPI.COMM_WORLD.size > 1:
        config.pluginmanager.register(RankAgreement(MPI.COMM_WORLD.Dup()))
        if MPI.COMM_WORLD.rank > 0:
            config.pluginmanager.unregister(name="terminalreporter")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Import no file for ``-m mpi`` that has no such test: every rank would."""
    if config.getoption("markexpr") != "mpi" or collection_path.suffix != ".py":
        return None
    return "mark.mpi" not in collection_path.read_text() or None


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with what takes longest, whole loops: at the end one worker would wait for the other's last file."""
    items.sort(key=lambda item: "validation" not in item.path.parts)


@pytest.fixture(scope="session")
def comm() -> MPI.Comm:
    """All ranks of the test run: one, unless it was started with mpiexec."""
    return MPI.COMM_WORLD


@pytest.fixture
def common_tmp_path(comm: MPI.Comm, tmp_path: Path) -> Path:
    """One empty folder for all ranks, where `tmp_path` is one for each."""
    return comm.bcast(tmp_path)


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk with room for 200 kB."""
    place = tmp_path / "disk"
    place.mkdir()
    made = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=200k", "tmpfs", place], capture_output=True, text=True, check=False
    )
    if made.returncode:
        pytest.skip(f"no file system may be mounted here: {made.stderr.strip()}")
    yield place
    subprocess.run(["umount", place], check=True)


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder of measured data."""
    path = Path(os.environ.get("HYDRABEAM_DATA", REPOSITORY.parent / "shared" / "data"))
    if not path.is_dir():
        pytest.skip(f"no measured data in {path}; HYDRABEAM_DATA names their folder")
    return path


@pytest.fixture(scope="session")
def mpiexec() -> Callable[..., subprocess.CompletedProcess[str]]:
    """``mpiexec(n, *command, timeout=300, **changes)`` runs a command on a number of ranks."""
    if MPI.COMM_WORLD.size > 1:
        pytest.skip("starts ranks of its own, so runs serially")
    launcher = shutil.which("mpiexec")
    if launcher is None:
        pytest.skip("no mpiexec on PATH")

    def run(n: int, *command: str | Path, timeout: float = 300, **changes: str) -> subprocess.CompletedProcess[str]:
        words = [launcher, "-n", str(n), *map(str, command)]
        with subprocess.Popen(
            words,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            env=environment(**{"OMP_NUM_THREADS": "1", **changes}),
        ) as process:
            try:
                out, err = process.communicate(timeout=timeout)
            except BaseException:
                _end(process)
                raise
        return subprocess.CompletedProcess(words, process.returncode, out, err)

    return run


def _end(process: subprocess.Popen[str]) -> None:
    process.terminate()  # mpiexec ends its ranks
    try:
        process.wait(10)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)


@pytest.fixture(scope="session")
def mpiexec_python(
    mpiexec: Callable[..., subprocess.CompletedProcess[str]],
) -> Callable[..., subprocess.CompletedProcess[str]]:
    """Like `mpiexec`, for Python source: ``mpiexec_python(n, source, ...)``."""
    return lambda n, source, *arguments, **options: mpiexec(n, sys.executable, "-c", source, *arguments, **options)
