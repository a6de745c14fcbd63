"""Damaged files, kills and full disks end in one clear line, or in a result that is right.

`tools/fuzz` does much more of it. All in one file, as the good files take half a minute to make.
"""

from __future__ import annotations

import signal
import sys
from pathlib import Path

import pytest

from tests.faults.campaign import Worker, counts, make_samples, run_cases
from tests.faults.cases import covering
from tests.faults.full_disk import FullDisks, can_mount
from tests.faults.kills import Kill, Kills
from tests.faults.oracle import CLEAN

SEED, FEWEST = 8, 60
"""There are more than fifty mutations, and forty pairs of a file and a family of them."""


@pytest.fixture(scope="module")
def samples(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_samples(tmp_path_factory.mktemp("samples"), quick=True)


@pytest.fixture(scope="module")
def kills(samples: Path) -> Kills:
    return Kills(samples)


@pytest.mark.study
def test_nothing_lost_and_nothing_wrong_in_silence(samples: Path) -> None:
    chosen = list(covering(SEED))
    verdicts = run_cases(samples, SEED, chosen, jobs=1)
    told = [verdict for verdict in verdicts if verdict["kind"] != CLEAN]
    assert not told, f"repeat with tools/fuzz --seed {SEED} --only INDEX"
    assert counts(verdicts)["cases"] == len(chosen) >= FEWEST


@pytest.mark.study
def test_a_process_that_ends_or_hangs_is_told_of(samples: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Without good files every case ends its process.
    (verdict,) = run_cases(samples / "nothing", SEED, [0], jobs=1)
    assert (verdict["kind"], verdict["words"]) == ("tracebacks", "the process ended with 1")
    monkeypatch.setattr("tests.faults.campaign.HANG_S", 0.01)
    (verdict,) = run_cases(samples, SEED, [0], jobs=1)
    assert verdict["kind"] == "hangs"


def test_words_that_come_at_once_are_all_heard(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.faults.campaign.HANG_S", 30.0)
    worker = Worker(Path(), SEED)
    both = r'input(); print("{\"target\": \"data\"}\n{\"kind\": \"clean\", \"seconds\": 1}", flush=True); input()'
    worker._words = [sys.executable, "-c", both]
    verdict = worker.run(0)
    worker.end()
    assert (verdict["target"], verdict["kind"]) == ("data", CLEAN)


@pytest.mark.study
def test_a_killed_rank_loses_nothing(kills: Kills) -> None:
    kind, words = kills.run(Kill("infer", 2, signal.SIGKILL, 0.8, one=True, earlier=False))
    assert kind == CLEAN, words


@pytest.mark.study
@pytest.mark.skipif(not can_mount(), reason="no file system may be mounted here")
def test_a_full_disk_ends_in_one_line(samples: Path) -> None:
    title, kind, words = FullDisks(samples).run(SEED, 17)  # infer, nearly enough room
    assert kind == CLEAN, f"{title}: {words}"
