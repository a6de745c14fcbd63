"""Folders that a run fills, and what is left of them where it was killed.

A run holds a lock on a file in its folder, which says where it runs and as which process. The system lets go of the
lock when the process ends, however it ends.
"""

from __future__ import annotations

import fcntl
import json
import logging
import os
import platform
import re
import secrets
import shutil
from pathlib import Path
from typing import Literal

from hydrabeam_mpi.io.kept_rounds import latest_round
from hydrabeam_mpi.io.manifest import MANIFEST, RUNNING, remove_result

logger = logging.getLogger(__name__)

Role = Literal["partial", "old"]


def new_name(path: Path, role: Role) -> Path:
    """Return a hidden name beside ``path`` that no other run has."""
    return path.with_name(f".{path.name}.{role}-{secrets.token_hex(4)}")


def claim(folder: Path) -> int:
    """Mark a folder as one that this process fills; return the descriptor that keeps the lock until it is closed."""
    lock = os.open(folder / RUNNING, os.O_RDWR | os.O_CREAT, 0o666)
    _try_to_lock(lock)
    # Only now: a file without content tells others nothing.
    os.write(lock, json.dumps({"host": platform.node(), "pid": os.getpid()}).encode())
    return lock


def find_abandoned(path: Path) -> list[Path]:
    """List the folders beside ``path`` that runs were filling when they were killed."""
    return [folder for folder in _beside(path, "partial") if _state_by_lock(folder) == "abandoned"]


def clear_leftovers(path: Path) -> None:
    """Remove what killed runs have left beside ``path``, and bring back what one of them had moved away.

    What may belong to a run that goes on, or is a finished result, stays, as does what has rounds of a loop. Each is
    told in one line.
    """
    sure = True
    for folder in _beside(path, "partial"):
        state = _state(folder)
        sure = sure and state not in ("running", "unknown")
        if latest_round(folder) is not None:
            continue  # a loop goes on from there
        if state == "abandoned":
            shutil.rmtree(folder, ignore_errors=True)
            logger.info("removed %s, which a run that was killed had left", folder)
        elif state == "finished":
            logger.warning("%s is the finished result of an earlier run: move it or remove it", folder)
        elif state == "unknown":
            logger.warning("%s is of another run, perhaps elsewhere: remove it once that has ended", folder)
    for folder in _beside(path, "old") if sure else ():
        if not path.exists():
            folder.rename(path)
            logger.info("brought back %s, which a run that was killed had moved away", path)
        elif remove_result(folder):
            logger.info("removed %s, which a run that was killed had left", folder)


def _beside(path: Path, role: Role) -> list[Path]:
    """List the folders that `new_name` has named."""
    ours = re.compile(re.escape(f".{path.name}.{role}-") + "[0-9a-f]{8}")
    if not path.parent.is_dir():
        return []
    return [found for found in sorted(path.parent.iterdir()) if ours.fullmatch(found.name) and found.is_dir()]


def _state(folder: Path) -> Literal["running", "abandoned", "finished", "unknown"]:
    """Tell what has become of the run that was filling a folder."""
    state = _state_by_lock(folder)
    return "finished" if state != "running" and (folder / MANIFEST).exists() else state


def _state_by_lock(folder: Path) -> Literal["running", "abandoned", "unknown"]:
    try:
        lock = os.open(folder / RUNNING, os.O_RDWR)
    except OSError:
        return "unknown"
    try:
        about = json.loads(os.read(lock, 1 << 12))
        if about["host"] != platform.node():
            return "unknown"  # locks do not reach from one machine to another on every file system
        free = _try_to_lock(lock)
        ended = not _is_alive(about["pid"]) if free is None else free
    except (ValueError, KeyError, TypeError, OSError):
        return "unknown"
    finally:
        os.close(lock)
    return "abandoned" if ended else "running"


def _try_to_lock(lock: int) -> bool | None:
    """Lock an open file, where no other process has; None where the file system knows no locks."""
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None
    return True


def _is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        pass  # it is another user's
    return True
