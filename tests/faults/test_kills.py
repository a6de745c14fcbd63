"""Commands killed at a moment drawn by seed; `tools/fuzz --kills` does so with all of them."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

from tests.faults.kills import Kill, Kills
from tests.faults.oracle import CLEAN


@pytest.mark.parametrize(
    "kill",
    [
        Kill("infer", 1, signal.SIGTERM, 0.7, one=False, earlier=True),
        Kill("simulate", 1, signal.SIGKILL, 0.8, one=False, earlier=True),
        Kill("loop", 2, signal.SIGKILL, 0.8, one=True, earlier=False),
    ],
    ids=lambda kill: kill.title,
)
def test_nothing_is_lost(samples: Path, kill: Kill) -> None:
    kind, words = Kills(samples).run(kill)
    assert kind == CLEAN, words
