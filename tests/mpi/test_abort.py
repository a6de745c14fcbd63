from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from subprocess import CompletedProcess

import pytest

Runner = Callable[..., CompletedProcess[str]]

PROLOGUE = """
import sys
from mpi4py.MPI import COMM_WORLD as world
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.mpi import install_abort_hook, refuse, together

class Gone(Exception): pass

install_abort_hook(world)
"""

REFUSING = """
def run():
    {body}
try:
    run()
except InputError as error:
    sys.exit(refuse(world, error))
world.Barrier()
"""


def run(mpiexec_python: Runner, n: int, body: str, **options: str) -> CompletedProcess[str]:
    start = time.monotonic()
    result = mpiexec_python(n, PROLOGUE + body, timeout=60, **options)
    assert time.monotonic() - start < 30, "not prompt"
    return result


@pytest.mark.parametrize("failing", [0, 1, 2])
def test_exception_on_one_rank_ends_all(mpiexec_python: Runner, failing: int) -> None:
    result = run(mpiexec_python, 3, f"if world.rank == {failing}: raise Gone('away')\nworld.Barrier()")
    assert result.returncode == 1
    assert result.stderr.count("Traceback") == 1
    assert result.stderr.count("Gone: away") == 1
    assert f"hydrabeam: error: rank {failing} of 3 failed" in result.stderr


@pytest.mark.parametrize(
    "body",
    ["raise Gone('away')", "with together(world): raise Gone('away')"],
)
def test_exception_on_all_ranks_is_told_once(mpiexec_python: Runner, body: str) -> None:
    result = run(mpiexec_python, 3, body)
    assert result.returncode == 1
    assert result.stderr.count("Gone: away") == 1


def test_exception_shared_by_one_group_ends_the_others(mpiexec_python: Runner) -> None:
    body = """
group = world.Split(world.rank == 0)
if world.rank:
    with together(group):
        if group.rank == 1: raise Gone('away')
world.Barrier()
"""
    result = run(mpiexec_python, 3, body)
    assert result.returncode == 1
    assert result.stderr.count("Gone: away") == 1
    assert "rank 2 of 3 failed" in result.stderr


def test_told_although_the_rank_was_made_quiet(mpiexec_python: Runner) -> None:
    body = """
if world.rank:
    sys.stderr = open('/dev/null', 'w')
    raise Gone('away')
world.Barrier()
"""
    assert run(mpiexec_python, 2, body).stderr.count("Gone: away") == 1


@pytest.mark.parametrize(
    "body",
    [
        "raise InputError('wrong', field='freq')",
        "with together(world): raise InputError('wrong', field='freq')",
        "if world.rank: raise InputError('wrong', field='freq')",
        "with together(world):\n        if world.rank: raise InputError('wrong', field='freq')",
    ],
    ids=["all", "all together", "some", "some together"],
)
def test_wrong_input_is_one_line_and_status_2(mpiexec_python: Runner, body: str) -> None:
    result = run(mpiexec_python, 3, REFUSING.format(body=body))
    assert result.returncode == 2
    assert result.stderr.splitlines().count("hydrabeam: error: freq: wrong") == 1
    assert "Traceback" not in result.stderr


def test_wrong_input_of_a_serial_run() -> None:
    source = PROLOGUE + REFUSING.format(body="raise InputError('wrong', field='freq')")
    result = subprocess.run([sys.executable, "-c", source], capture_output=True, text=True, check=False)
    assert result.returncode == 2
    assert result.stderr == "hydrabeam: error: freq: wrong\n"


def test_uncaught_wrong_input_has_no_traceback(mpiexec_python: Runner) -> None:
    result = run(mpiexec_python, 2, "if world.rank: raise InputError('wrong', field='freq')\nworld.Barrier()")
    assert result.returncode == 2
    assert "hydrabeam: error: freq: wrong" in result.stderr
    assert "Traceback" not in result.stderr


def test_interrupt_ends_all_without_traceback(mpiexec_python: Runner) -> None:
    result = run(mpiexec_python, 2, "if world.rank: raise KeyboardInterrupt\nworld.Barrier()")
    assert result.returncode == 130
    assert "Traceback" not in result.stderr


def test_serial_run_keeps_pythons_own_hook(mpiexec_python: Runner) -> None:
    result = run(mpiexec_python, 1, "assert sys.excepthook is sys.__excepthook__")
    assert result.returncode == 0, result.stderr
