"""A disk that takes no more, at every size from next to nothing to just enough."""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from hydrabeam_mpi.io.kept_rounds import latest_round
from tests.faults.launch import Setting, broken, left_beside, run, settle
from tests.faults.oracle import CLEAN, HANGS, LOST, TRACEBACKS, Outcome, state, unclear

COMMANDS = ("simulate", "infer", "loop", "report")
SMALLEST_KB = 16


@contextmanager
def small_disk(folder: Path, kilobytes: int) -> Iterator[Path]:
    """Mount a file system of this size in memory.

    Raises
    ------
    PermissionError
        Where that is not allowed.
    """
    folder.mkdir()
    words = ["mount", "-t", "tmpfs", "-o", f"size={kilobytes}k", "tmpfs", str(folder)]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if done.returncode:
        raise PermissionError(f"a small disk cannot be mounted here: {done.stderr.strip()}")
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def can_mount() -> bool:
    """Whether a file system may be mounted here."""
    with tempfile.TemporaryDirectory() as own:
        try:
            with small_disk(Path(own) / "disk", SMALLEST_KB):
                return True
        except OSError:
            return False


class FullDisks:
    """Runs commands whose output lies on a small disk; knows how much room each needs."""

    def __init__(self, samples: Path) -> None:
        self._samples = samples
        self._needs: dict[str, int] = {}

    def run(self, seed: int, index: int) -> tuple[str, str, str]:
        """Draw command, ranks and size, run, and judge: title, kind of ending and words."""
        rng = np.random.default_rng([seed, index, 11])
        command, ranks = COMMANDS[index % len(COMMANDS)], 1 + index // len(COMMANDS) % 2
        earlier = command != "report" and bool(rng.random() < 0.3)
        # Those that are nearly large enough are what a program overlooks.
        kilobytes = SMALLEST_KB + int(self._need(command) * rng.choice([rng.uniform(0, 0.9), rng.uniform(0.9, 1.1)]))
        title = f"{command} on {ranks}, {kilobytes} kB{', with an earlier result' if earlier else ''}"
        with tempfile.TemporaryDirectory(prefix="disk") as own:
            folder = Path(own).resolve()
            held = self._samples / ("mock" if earlier else "result")
            room = kilobytes + (_kilobytes(held) if earlier or command == "report" else 0)
            with small_disk(folder / "disk", room) as disk:
                setting = settle(self._samples, command, folder / "work", disk / "out", earlier)
                before = state(setting.out)
                outcome = run(setting.words(ranks))
                if outcome is None:
                    return title, HANGS, "does not end"
                return title, *_look(setting, outcome, before)

    def _need(self, command: str) -> int:
        """Return how much room a command's result takes, kB."""
        if command not in self._needs:
            with tempfile.TemporaryDirectory(prefix="disk") as own:
                folder = Path(own).resolve()
                setting = settle(self._samples, command, folder / "work", folder / "out")
                before = _kilobytes(setting.out) if setting.out.exists() else 0
                outcome = run(setting.words(1))
                assert outcome is not None, f"{command} hangs"
                assert outcome.status == 0, outcome.err
                self._needs[command] = _kilobytes(setting.out) - before
        return self._needs[command]


def _look(setting: Setting, outcome: Outcome, before: dict[str, tuple[int, str]]) -> tuple[str, str]:
    """Judge what a run left on a small disk."""
    words = unclear(outcome, ("-o", str(setting.out)))
    if words:
        return TRACEBACKS, words
    after = state(setting.out)
    if outcome.status == 2 and setting.command != "report" and before != after and (before or broken(setting)):
        return LOST, "an earlier result is changed" if before else str(broken(setting))
    if not before.items() <= after.items() and setting.command == "report":
        return LOST, "the result is changed"
    words = broken(setting) if outcome.status == 0 else None
    if words:
        return LOST, words
    # Rounds of a loop that have ended are kept, for the next run to go on from.
    left = [name for name in left_beside(setting) if latest_round(setting.out.parent / name) is None]
    if left:
        return LOST, f"left behind: {', '.join(left)}"
    return CLEAN, outcome.lines[-1] if outcome.lines else ""


def _kilobytes(folder: Path) -> int:
    """Return what a folder takes, by pages of memory as a tmpfs counts it, kB."""
    return sum(-(-path.stat().st_size // 4096) * 4 + 4 for path in folder.rglob("*"))
