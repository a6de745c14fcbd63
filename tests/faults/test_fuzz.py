"""Damaged files of every kind end in one clear line, or in a result that is right; `tools/fuzz` runs many more."""

from __future__ import annotations

from pathlib import Path

from tests.faults.campaign import counts, run_cases
from tests.faults.oracle import CLEAN

SEED, CASES = 8, 200


def test_nothing_lost_and_nothing_wrong_in_silence(samples: Path) -> None:
    verdicts = run_cases(samples, SEED, range(CASES), jobs=1)
    told = [verdict for verdict in verdicts if verdict["kind"] != CLEAN]
    assert not told, f"repeat with tools/fuzz --seed {SEED} --only INDEX"
    assert counts(verdicts)["cases"] == CASES


def test_a_process_that_ends_or_hangs_is_told_of(samples: Path, monkeypatch) -> None:
    # Without good files every case ends its process.
    (verdict,) = run_cases(samples / "nothing", SEED, [0], jobs=1)
    assert (verdict["kind"], verdict["words"]) == ("tracebacks", "the process ended with 1")
    monkeypatch.setattr("tests.faults.campaign.HANG_S", 0.01)
    (verdict,) = run_cases(samples, SEED, [0], jobs=1)
    assert verdict["kind"] == "hangs"
