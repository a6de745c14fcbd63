"""The plugin that lets pytest run under mpiexec reports and ends as it should."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from subprocess import CompletedProcess

import pytest

CONFTEST = "from tests.conftest import *\n"
HEAD = "import pytest\nfrom mpi4py.MPI import COMM_WORLD as world\n"


@pytest.fixture
def run_ranks(mpiexec: Callable[..., CompletedProcess[str]], tmp_path: Path) -> Callable[[str], CompletedProcess[str]]:
    def run(source: str) -> CompletedProcess[str]:
        (tmp_path / "conftest.py").write_text(CONFTEST)
        (tmp_path / "test_it.py").write_text(HEAD + source)
        repository = str(Path(__file__).parents[1])
        options = ("-p", "no:cacheprovider", "--color=no", "--rootdir", tmp_path)
        return mpiexec(2, sys.executable, "-m", "pytest", *options, tmp_path, PYTHONPATH=repository)

    return run


def test_all_pass_and_one_rank_reports(run_ranks: Callable[[str], CompletedProcess[str]]) -> None:
    result = run_ranks("def test_sum(): assert world.allreduce(1) == 2\n")
    assert result.returncode == 0, result.stdout + result.stderr
    assert result.stdout.count("1 passed") == 1


@pytest.mark.parametrize(
    ("failing", "outcome"), [(0, "assert False"), (1, "assert False"), (1, "pytest.skip('not here')")]
)
def test_failure_on_one_rank_fails_all(
    run_ranks: Callable[[str], CompletedProcess[str]], failing: int, outcome: str
) -> None:
    result = run_ranks(
        f"def test_one():\n    if world.rank == {failing}: {outcome}\ndef test_two(): assert world.allreduce(1) == 2\n"
    )
    assert result.returncode == 1
    assert result.stdout.count("1 failed, 1 passed") == 1
    assert f"*** rank {failing}:" in result.stdout


def test_failure_in_a_fixture_on_one_rank(run_ranks: Callable[[str], CompletedProcess[str]]) -> None:
    result = run_ranks(
        "@pytest.fixture\ndef broken():\n    assert world.rank == 0, 'broken here'\n"
        "def test_one(broken): world.Barrier()\n"
        "def test_two(): assert world.allreduce(1) == 2\n"
    )
    assert result.returncode == 1
    assert "1 passed, 1 error" in result.stdout
    assert "broken here" in result.stdout


def test_rank_left_in_a_collective_ends_the_run(run_ranks: Callable[[str], CompletedProcess[str]]) -> None:
    start = time.monotonic()
    result = run_ranks("def test_one():\n    assert world.rank == 0, 'gone astray'\n    world.Barrier()\n")
    assert result.returncode not in (0, None)
    assert "gone astray" in result.stderr
    assert time.monotonic() - start < 40


def test_ranks_that_collect_different_tests(run_ranks: Callable[[str], CompletedProcess[str]]) -> None:
    result = run_ranks("if world.rank:\n    def test_one(): pass\ndef test_two(): pass\n")
    assert result.returncode not in (0, None)
    assert "the ranks collected different tests" in result.stdout
