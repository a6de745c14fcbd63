"""Every command ended at a random moment: nothing lost, nothing half, and the next run works."""

from __future__ import annotations

import os
import shutil
import signal
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from tests.faults.launch import (
    COMMANDS,
    Setting,
    broken,
    descendants,
    end_session,
    finish,
    left_beside,
    run,
    settle,
    start,
    still_there,
)
from tests.faults.oracle import CLEAN, HANGS, LOST, TRACEBACKS, WRONG, Outcome, answer_of, same, state

SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGKILL)
SOON_S = 60.0
"""Seconds within which a program that got a signal ends, on a machine that does much else."""


@dataclass(frozen=True)
class Kill:
    """One run that is ended.

    Attributes
    ----------
    command : str
    ranks : int
    number : signal.Signals
    moment : float
        When, as a fraction of the seconds that the run takes.
    one : bool
        Whether one process alone gets the signal: the launcher; of SIGKILL, one rank. Else all do.
    earlier : bool
        Whether the run is to replace an earlier result.
    """

    command: str
    ranks: int
    number: signal.Signals
    moment: float
    one: bool
    earlier: bool

    @property
    def title(self) -> str:
        """What to call it."""
        return (
            f"{self.command} on {self.ranks}, {self.number.name} at {self.moment:.2f} to {'one' if self.one else 'all'}"
            f"{', with an earlier result' if self.earlier else ''}"
        )


def drawn(seed: int, index: int) -> Kill:
    """Draw the kill with this number; commands, ranks and signals take turns."""
    rng = np.random.default_rng([seed, index, 9])
    command = COMMANDS[index % len(COMMANDS)]
    ranks = 1 + index // len(COMMANDS) % 3
    number = SIGNALS[index // (3 * len(COMMANDS)) % len(SIGNALS)]
    one, earlier = rng.random() < 0.5, command in ("simulate", "infer", "loop") and rng.random() < 0.5
    return Kill(command, ranks, number, float(rng.uniform(0.05, 1.05)), bool(one), bool(earlier))


class Kills:
    """Kills commands; knows how long each takes when it is left alone, and what it gives then."""

    def __init__(self, samples: Path) -> None:
        self._samples = samples
        self._whole: dict[tuple[str, int], float] = {}
        self._answers: dict[str, Any] = {}

    def run(self, kill: Kill) -> tuple[str, str]:
        """Run, kill and look; return the kind of ending and words."""
        seconds = self._alone(kill.command, kill.ranks)
        with tempfile.TemporaryDirectory(prefix="kill") as own:
            folder = Path(own).resolve()
            setting = settle(self._samples, kill.command, folder / "work", folder / "place" / "out", kill.earlier)
            samples, before = state(self._samples), state(setting.folder)
            earlier = state(setting.out)
            process = start(setting.words(kill.ranks))
            time.sleep(kill.moment * seconds)
            everyone = descendants(process.pid)
            _send(kill, everyone)
            outcome = finish(process, SOON_S)
            if outcome is None or still_there(everyone):
                for one in everyone:
                    end_session(one.pid)
                return HANGS, "does not end"
            if state(self._samples) != samples or state(setting.folder) != before:
                return LOST, "an input is changed or gone"
            return self._look(kill, setting, outcome, earlier)

    def _look(self, kill: Kill, setting: Setting, outcome: Outcome, earlier: dict[str, Any]) -> tuple[str, str]:
        """Judge what the ended run left, and run again."""
        if "Traceback" in outcome.err and kill.number != signal.SIGKILL:
            return TRACEBACKS, outcome.err[-300:]
        there = state(setting.out)
        untouched = earlier.items() <= there.items()
        if earlier and not untouched and kill.command == "report":
            return LOST, "the result is changed"
        words = None if kill.earlier and untouched else broken(setting)
        if words:
            return LOST, words
        if earlier and not there:
            return LOST, "the earlier result is gone"
        left = left_beside(setting)
        if left and kill.number != signal.SIGKILL and kill.ranks == 1:
            return LOST, f"left behind: {', '.join(left)}"
        if outcome.status == 0:
            return CLEAN, "had ended"
        ready = kill.command != "report" and there and not (earlier and untouched)
        if ready and not _interrupted(setting.out):
            return CLEAN, "the result was whole"
        again = run(setting.words(1))
        if again is None:
            return HANGS, "the next run does not end"
        if again.status != 0:
            return LOST, f"the next run fails: {again.err[-300:]}"
        words = broken(setting)
        if words:
            return LOST, f"after the next run {words}"
        left = left_beside(setting)
        if left:
            return LOST, f"after the next run there is still {', '.join(left)}"
        if not same(self._answers[kill.command], self._answer(setting, again)):
            return WRONG, "the next run gives other numbers"
        return CLEAN, "ran again" if not left else f"ran again, {left[0]} removed"

    def _alone(self, command: str, ranks: int) -> float:
        """Return the seconds of a run that nobody ends."""
        if (command, ranks) not in self._whole:
            with tempfile.TemporaryDirectory(prefix="kill") as own:
                folder = Path(own).resolve()
                setting = settle(self._samples, command, folder / "work", folder / "place" / "out")
                started = time.monotonic()
                outcome = run(setting.words(ranks))
                assert outcome is not None, f"{command} on {ranks} hangs"
                assert outcome.status == 0, outcome.err
                self._whole[command, ranks] = time.monotonic() - started
                self._answers.setdefault(command, self._answer(setting, outcome))
        return self._whole[command, ranks]

    def _answer(self, setting: Setting, outcome: Outcome) -> Any:
        if setting.command in ("init", "report"):
            return {}  # words, in which the folder's name and times are
        return answer_of(setting.command, setting.out, outcome)


def _interrupted(out: Path) -> bool:
    """Whether a result says of itself that it is not finished."""
    return any("interrupted" in path.read_text() for path in out.glob("*.json"))


def _send(kill: Kill, processes: list[psutil.Process]) -> None:
    """Send the signal to all, or to one."""
    if not processes:
        return
    chosen = processes
    if kill.one:
        ranks = [process for process in processes if "hydrabeam_mpi" in _command_line(process)]
        chosen = ranks[-1:] if kill.number == signal.SIGKILL and ranks else processes[:1]
    for process in chosen:
        try:
            os.kill(process.pid, kill.number)
        except ProcessLookupError:
            continue


def _command_line(process: psutil.Process) -> list[str]:
    try:
        return list(process.cmdline())
    except (psutil.NoSuchProcess, psutil.ZombieProcess):
        return []


def can_kill() -> bool:
    """Whether there is a launcher for several ranks."""
    return shutil.which("mpiexec") is not None
