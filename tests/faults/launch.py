"""The program as its own processes, on some ranks, and what it left."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil
import tomli_w

from tests.cli.conftest import changed
from tests.faults.oracle import Outcome, nonfinite
from tests.faults.samples import REPOSITORY, from_files, simulation

COMMANDS = ("simulate", "infer", "loop", "report", "init")
ENOUGH_S = 300.0
"""Seconds within which any of these runs ends, on a machine that does much else."""


@dataclass(frozen=True)
class Setting:
    """A command in a folder of its own.

    Attributes
    ----------
    command : str
    folder : Path
        With the inputs that are the run's own: the job, or the result that it reports on.
    out : Path
        Where the result appears.
    earlier : bool
        Whether a result stood there before, that is to be replaced.
    """

    command: str
    folder: Path
    out: Path
    earlier: bool = False

    def words(self, ranks: int) -> list[str]:
        """Return the command line."""
        launcher = [shutil.which("mpiexec") or "mpiexec", "-n", str(ranks)] if ranks > 1 else []
        program = [*launcher, sys.executable, "-m", "hydrabeam_mpi", self.command]
        if self.command == "report":
            return [*program, str(self.out)]
        if self.command == "init":
            return [*program, str(self.folder / "data.uvh5")]
        return [*program, str(self.folder / "job.toml"), "-o", str(self.out), *["--overwrite"] * self.earlier]


def settle(samples: Path, command: str, folder: Path, out: Path, earlier: bool = False) -> Setting:
    """Lay out what a command needs; where the output is an earlier result, it is of the same command."""
    folder.mkdir(exist_ok=True)
    if command == "init":
        shutil.copy(samples / "data.uvh5", folder)
        return Setting(command, folder, out)
    if command == "report":
        shutil.copytree(samples / "result", out)
        return Setting(command, folder, out)
    job: dict[str, Any] = simulation() if command == "simulate" else from_files(samples, data__channels=[0])
    if command == "loop":
        # Several rounds, so that there is something to lose.
        job = changed(job, {"loop.effects": None, "loop.max_rounds": 3, "sky.n_sources": 300})
    (folder / "job.toml").write_text(tomli_w.dumps(job))
    if earlier:
        shutil.copytree(samples / "mock", out)
    return Setting(command, folder, out, earlier)


def start(words: list[str]) -> subprocess.Popen[str]:
    """Start a program in a session of its own."""
    return subprocess.Popen(
        words,
        cwd=REPOSITORY,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env={**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(REPOSITORY)},
    )


def finish(process: subprocess.Popen[str], seconds: float = ENOUGH_S) -> Outcome | None:
    """Wait for a program's end and return what it said, or None where it hangs, and is ended."""
    try:
        out, err = process.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        end_session(process.pid)
        process.communicate()
        return None
    return Outcome(process.returncode, out, err)


def run(words: list[str]) -> Outcome | None:
    """Run a program to its end."""
    return finish(start(words))


def session(leader: int) -> list[psutil.Process]:
    """List the processes of a session that are alive."""
    found = []
    for process in psutil.process_iter():
        try:
            if os.getsid(process.pid) == leader and process.status() != psutil.STATUS_ZOMBIE:
                found.append(process)
        except (ProcessLookupError, psutil.NoSuchProcess):
            continue
    return found


def descendants(leader: int) -> list[psutil.Process]:
    """List the processes that came of one, and itself; MPICH's ranks have a session of their own."""
    try:
        first = psutil.Process(leader)
        return [first, *first.children(recursive=True)]
    except psutil.NoSuchProcess:
        return []


def end_session(leader: int) -> None:
    """Kill a program with all that came of it."""
    for process in descendants(leader):
        try:
            process.send_signal(signal.SIGKILL)
        except psutil.NoSuchProcess:
            continue


def still_there(processes: list[psutil.Process], seconds: float = 20.0) -> list[psutil.Process]:
    """Return which processes do not end within some seconds."""
    until = time.monotonic() + seconds
    _, alive = psutil.wait_procs(processes, timeout=max(0.0, until - time.monotonic()))
    return [process for process in alive if process.status() != psutil.STATUS_ZOMBIE]


def broken(setting: Setting) -> str | None:
    """Say what is wrong with what stands in the place of the output, if anything; None also where there is nothing."""
    out = setting.out
    if setting.command == "report":
        page = out / "report.html"
        if page.exists() and not page.read_text().rstrip().endswith("</html>"):
            return "half a page"
        pictures = [path for path in out.rglob("figures/*.png") if not path.read_bytes().endswith(b"IEND\xaeB`\x82")]
        return f"half a picture, {pictures[0].name}" if pictures else None
    if not out.exists():
        return None
    needed = {"simulate": "data.uvh5", "infer": "posterior.h5", "loop": "loop.json"}
    lacking = [name for name in ("provenance.json", "job.toml") if not (out / name).exists()]
    if lacking or not any((out / name).exists() for name in needed.values()):
        return f"half a result: {', '.join(sorted(path.name for path in out.iterdir()))}"
    return nonfinite(out)


def left_beside(setting: Setting) -> list[str]:
    """Name what lies beside the output and begins with a dot, as unfinished folders do."""
    places = {setting.out.parent, setting.out, setting.out / "figures", setting.folder}
    return sorted({path.name for place in places if place.is_dir() for path in place.glob(".*")})
