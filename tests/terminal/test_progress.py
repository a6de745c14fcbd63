"""How much is said, and how long it will still take."""

from __future__ import annotations

import logging
import re

import pytest

from hydrabeam_mpi.terminal import progress
from hydrabeam_mpi.terminal.console import console
from hydrabeam_mpi.terminal.progress import loudness, say, tell, track, warn


def test_time_left_is_told_where_work_goes_on(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(progress, "SECONDS", -1.0)
    assert list(track(range(3), 3, "design", show=True)) == [0, 1, 2]
    lines = capfd.readouterr().err.splitlines()
    assert [re.sub(r"about \d+ s", "about - s", line) for line in lines] == [
        "hydrabeam: design: 1 of 3, about - s left",
        "hydrabeam: design: 2 of 3, about - s left",
    ]
    assert list(track(range(3), 3, "design", show=False)) == [0, 1, 2]
    assert capfd.readouterr().err == ""


def test_quiet_leaves_warnings_and_errors(capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "SECONDS", -1.0)
    with console(speaks=True), loudness(quiet=True):
        say("reading")
        assert list(track(range(2), 2, "design", show=True)) == [0, 1]
        logging.getLogger("hydrabeam_mpi.io").info("noted")
        logging.getLogger("hydrabeam_mpi.io").warning("odd")
        warn(["doubtful"])
        tell("interrupted")
    say("heard again")
    assert capfd.readouterr().err.splitlines() == [
        "hydrabeam: warning: odd",
        "hydrabeam: warning: doubtful",
        "hydrabeam: interrupted",
        "hydrabeam: heard again",
    ]


def test_verbose_lines_have_the_time(capfd: pytest.CaptureFixture[str]) -> None:
    with loudness(verbose=True):
        say("reading")
    assert re.fullmatch(r"hydrabeam: \d+\.\d s: reading\n", capfd.readouterr().err)
