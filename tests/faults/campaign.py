"""Many cases over a few worker processes, with a watchdog: a case that hangs or ends its process is told of."""

from __future__ import annotations

import json
import os
import queue
import select
import signal
import subprocess
import sys
import threading
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from tests.faults.oracle import HANGS, KINDS, TRACEBACKS
from tests.faults.samples import REPOSITORY

HANG_S = 120.0
"""Seconds after which a case hangs: the slowest good one takes three on a quiet machine."""

Table = dict[str, Any]


class Worker:
    """A process that runs cases; a new one takes its place where it ends."""

    def __init__(self, samples: Path, seed: int) -> None:
        self._words = [sys.executable, "-m", "tests.faults.worker", str(samples), str(seed)]
        self._process: subprocess.Popen[str] | None = None
        self._heard = b""

    def run(self, index: int) -> Table:
        """Run one case."""
        process = self._process or self._start()
        assert process.stdin is not None
        print(index, file=process.stdin, flush=True)
        told: Table = {"index": index, "kind": HANGS, "words": f"nothing for {HANG_S:g} s"}
        # First what is done, then what came of it: of a process that ends, the first is known.
        while "seconds" not in told:
            line = self._next_line(process)
            if not line:
                if line is not None:
                    told |= {"kind": TRACEBACKS, "words": _how(process.wait(HANG_S))}
                self.end()
                break
            told |= json.loads(line)
        return told

    def _next_line(self, process: subprocess.Popen[str]) -> bytes | None:
        """Return what a process says next; nothing once it has ended, None where it hangs.

        Lines that come at once are told apart here: what Python's own reader holds back no `select` knows of.
        """
        assert process.stdout is not None
        while b"\n" not in self._heard:
            ready, _, _ = select.select([process.stdout], [], [], HANG_S)
            if not ready:
                return None
            heard = os.read(process.stdout.fileno(), 1 << 16)
            if not heard:
                return b""
            self._heard += heard
        line, _, self._heard = self._heard.partition(b"\n")
        return line

    def _start(self) -> subprocess.Popen[str]:
        self._process = subprocess.Popen(
            self._words,
            cwd=REPOSITORY,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            start_new_session=True,
            env={**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(REPOSITORY)},
        )
        return self._process

    def end(self) -> None:
        """End the process, if there is one."""
        if self._process is not None:
            if self._process.poll() is None:
                os.killpg(self._process.pid, signal.SIGKILL)
            self._process.communicate()
            self._process, self._heard = None, b""


def _how(status: int) -> str:
    return f"the process ended by {signal.Signals(-status).name}" if status < 0 else f"the process ended with {status}"


def run_cases(
    samples: Path, seed: int, indices: Iterable[int], jobs: int, tell: Callable[[Table], None] = lambda _: None
) -> list[Table]:
    """Run cases on some processes and return all verdicts in order; ``tell`` hears of each as it comes."""
    waiting: queue.SimpleQueue[int] = queue.SimpleQueue()
    for index in indices:
        waiting.put(index)
    verdicts: list[Table] = []
    lock = threading.Lock()

    def serve() -> None:
        worker = Worker(samples, seed)
        try:
            while True:
                verdict = worker.run(waiting.get_nowait())
                with lock:
                    verdicts.append(verdict)
                    tell(verdict)
        except queue.Empty:
            pass
        finally:
            worker.end()

    threads = [threading.Thread(target=serve) for _ in range(jobs)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return sorted(verdicts, key=lambda verdict: verdict["index"])


def make_samples(folder: Path, quick: bool = False) -> Path:
    """Make the good files in a process of their own, as they need MPI; ``quick`` without trying the slow ones."""
    words = [sys.executable, "-m", "tests.faults.prepare", str(folder), *["quick"] * quick]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(REPOSITORY)}
    done = subprocess.run(words, cwd=REPOSITORY, check=False, capture_output=True, text=True, env=environment)
    assert done.returncode == 0, f"the good files are not taken: {done.stderr[-2000:]}"
    return folder


def counts(verdicts: Iterable[Table]) -> dict[str, int]:
    """Count the kinds of verdicts."""
    found = Counter(verdict["kind"] for verdict in verdicts)
    return {"cases": sum(found.values()), **{kind: found[kind] for kind in KINDS}}
