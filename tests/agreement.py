"""Pytest under mpiexec: all ranks run the same tests and agree on the outcome of each.

A test that fails on one rank fails on all, so that every rank goes on to the same next test, and rank 0,
which alone reports, tells why. A rank whose test failed does not wait long for ranks that hang in a
collective of that test: it ends the run.
"""

from __future__ import annotations

import sys
import time
import zlib
from collections.abc import Generator

import numpy as np
import pytest
from mpi4py import MPI

OUTCOMES = ("passed", "skipped", "failed")
PATIENCE = {"passed": 300.0, "skipped": 300.0, "failed": 10.0}  # seconds


class RankAgreement:
    """Pytest plugin; ``comm`` is used for nothing else."""

    def __init__(self, comm: MPI.Comm) -> None:
        self.comm = comm

    def pytest_collection_finish(self, session: pytest.Session) -> None:
        nodeids = "\n".join(item.nodeid for item in session.items)
        everyone = self._exchange(zlib.crc32(nodeids.encode()), 300.0, "collection")
        if len(set(everyone)) > 1:
            pytest.exit("the ranks collected different tests", returncode=pytest.ExitCode.INTERNAL_ERROR)

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_makereport(self) -> Generator[None, pytest.TestReport, pytest.TestReport]:
        report = yield
        words = f"{report.nodeid} ({report.when}) {report.outcome}\n{report.longreprtext}"
        everyone = self._exchange(OUTCOMES.index(report.outcome), PATIENCE[report.outcome], words)
        if report.failed or len(set(everyone)) > 1:
            report.longrepr = self._combine(report)
            report.outcome = "failed"
        return report

    def _combine(self, report: pytest.TestReport) -> str:
        """What each rank says of a test on which some rank failed, or on which the ranks disagree."""
        words = self.comm.allgather(report.longreprtext or f"{report.when} {report.outcome}")
        ranks_of = {text: [r for r, other in enumerate(words) if other == text] for text in words}
        return "\n".join(f"*** rank {', '.join(map(str, ranks))}:\n{text}" for text, ranks in ranks_of.items())

    def _exchange(self, value: int, patience: float, words: str) -> list[int]:
        """Gather an integer of every rank; end the run if the others do not come to do the same."""
        everyone = np.empty(self.comm.size, np.int64)
        request = self.comm.Iallgather(np.array([value], np.int64), everyone)
        deadline = time.monotonic() + patience
        while not request.Test():
            if time.monotonic() > deadline:
                print(
                    f"\nrank {self.comm.rank} waited {patience:.0f} s for the others after {words}",
                    file=sys.__stderr__,
                    flush=True,
                )
                self.comm.Abort(1)
            time.sleep(0.001)
        return everyone.tolist()
