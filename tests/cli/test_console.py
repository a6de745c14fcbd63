"""Who says what: rank 0 alone, in lines of its own, and whatever another rank fails of, once."""

from __future__ import annotations

import logging
import sys
import warnings
from collections.abc import Callable
from subprocess import CompletedProcess

import pytest

from hydrabeam_mpi.terminal.console import console

Runner = Callable[..., CompletedProcess[str]]

# A module of the package, and one of another, each of which warns and logs.
SOURCE = """
import logging, warnings
def speak():
    warnings.warn("two\\nlines")
    warnings.warn("old", DeprecationWarning)
    warnings.warn("unclosed", ResourceWarning)
    logging.getLogger(__name__).warning("%d sources left out", 3)
    logging.getLogger(__name__).info("noted")
    logging.getLogger(__name__).debug("unheard")
"""


def speaker(name: str) -> Callable[[], None]:
    names: dict[str, object] = {"__name__": name}
    exec(SOURCE, names)
    return names["speak"]  # type: ignore[return-value]


def test_notes_of_the_package_are_lines(capfd: pytest.CaptureFixture[str]) -> None:
    with console(speaks=True):
        speaker("hydrabeam_mpi.io.anything")()
        print("a result")
    out, err = capfd.readouterr()
    assert out == "a result\n"
    assert err.splitlines() == [
        "hydrabeam: warning: two lines",
        "hydrabeam: warning: 3 sources left out",
        "hydrabeam: noted",
    ]


@pytest.mark.parametrize("name", ["pyuvdata.uvdata", "hydrabeam_mpify"])
def test_notes_of_others_are_not(name: str, capfd: pytest.CaptureFixture[str]) -> None:
    with console(speaks=True):
        speaker(name)()
    assert capfd.readouterr() == ("", "")


def test_numerical_warnings_of_the_package_are_told(capfd: pytest.CaptureFixture[str]) -> None:
    names: dict[str, object] = {"__name__": "hydrabeam_mpi.model.anything"}
    with console(speaks=True):
        exec("import numpy as np\nnp.log(np.zeros(1))", names)
    assert capfd.readouterr().err == "hydrabeam: warning: divide by zero encountered in log\n"


def test_other_ranks_are_silent(capfd: pytest.CaptureFixture[str]) -> None:
    with console(speaks=False):
        speaker("hydrabeam_mpi.io.anything")()
        print("a result")
        print("a complaint", file=sys.stderr)
    assert capfd.readouterr() == ("", "")


def test_all_is_as_before_afterwards() -> None:
    def state() -> tuple[object, ...]:
        root, package = logging.getLogger(), logging.getLogger("hydrabeam_mpi")
        handlers = [*root.handlers], [*package.handlers], package.level
        return sys.stdout, sys.stderr, warnings.showwarning, [*warnings.filters], *handlers

    before = state()
    with pytest.raises(KeyboardInterrupt), console(speaks=False):
        raise KeyboardInterrupt
    assert state() == before


def test_warnings_come_back_when_asked_for(mpiexec_python: Runner) -> None:
    source = (
        "import warnings\nfrom hydrabeam_mpi.terminal.console import console\nwith console(True): warnings.warn('mine')"
    )
    assert mpiexec_python(1, source).stderr == ""
    assert "UserWarning: mine" in mpiexec_python(1, source, PYTHONWARNINGS="default::UserWarning").stderr


FAILING = """
import sys
from mpi4py.MPI import COMM_WORLD as world
from hydrabeam_mpi import cli
from hydrabeam_mpi.setup import job_file

def fail(comm, *_, **__):
    {body}
job_file.load = fail
sys.exit(cli.main(["infer", "job.toml", "-o", "out"]))
"""


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("if comm.rank == 1: raise ZeroDivisionError('away')\n    comm.Barrier()", "rank 1 of 2 failed"),
        ("raise ZeroDivisionError('away')", "rank 0 of 2 failed"),
    ],
    ids=["one rank", "all ranks"],
)
def test_a_failure_is_told_once(mpiexec_python: Runner, body: str, words: str) -> None:
    result = mpiexec_python(2, FAILING.format(body=body))
    assert result.returncode == 1
    assert result.stderr.count("Traceback") == 1
    assert result.stderr.count("ZeroDivisionError: away") == 1
    assert f"hydrabeam: error: {words}" in result.stderr
