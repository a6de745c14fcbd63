"""The end of a run that fails: promptly, on all ranks, with one message."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import Any

from mpi4py import MPI

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.mpi.failure import how_shared

INPUT_ERROR_STATUS = 2
INTERRUPTED_STATUS = 130
LEAVING_S = 15.0
"""Seconds after which a rank that has got a signal ends all, where rank 0 has not done so: it has then got none.

Nobody waits for it where a launcher passes a signal on to all ranks: rank 0 ends them once it has left, which means to
move a few files, and takes less even on a busy machine.
"""
HEARD_S = 0.2
"""Seconds that a launcher has to pass on what a rank has said: when one aborts it may drop what it has not read yet."""

_saying = threading.Lock()


@dataclass
class _AbortHook:
    """Ends all ranks of ``comm``, after what another hook does that was there before."""

    comm: MPI.Comm
    before: Callable[[type[BaseException], BaseException, TracebackType | None], Any]

    def __call__(self, kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        try:
            if self.before is not sys.__excepthook__:  # which says what is said here
                self.before(kind, error, trace)
        finally:
            _end_all(self.comm or MPI.COMM_WORLD, error)  # the caller may have freed the communicator


def install_abort_hook(comm: MPI.Comm) -> None:
    """Let an uncaught exception on any rank of ``comm`` end them all; again is as good as once.

    Without it, a rank that fails waits at its exit for the others, and they wait for it in their next
    collective. A hook that the caller has set is called first.
    """
    if comm.size == 1:
        return
    hook = sys.excepthook
    sys.excepthook = _AbortHook(comm, hook.before if isinstance(hook, _AbortHook) else hook)


def refuse(comm: MPI.Comm, error: InputError) -> int:
    """Say once, in one line, what is wrong with the input, and return the exit status for it.

    Where `hydrabeam_mpi.mpi.together` did not raise ``error`` on all ranks of ``comm``, the others are ended.
    """
    if how_shared(error).n_ranks < comm.size:
        _end_all(comm, error)
    elif how_shared(error).speaks:
        _say(error)
    return INPUT_ERROR_STATUS


def end_interrupted(comm: MPI.Comm) -> None:
    """End all ranks after a signal, by rank 0 if it has got it too: it says so, and may have something to save."""
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)
    if comm.rank > 0:
        time.sleep(LEAVING_S)
    else:
        # Only once, whichever thread is first.
        _saying.acquire()
        sys.stdout.flush()
        print("hydrabeam: interrupted", file=sys.__stderr__, flush=True)
        time.sleep(HEARD_S)
    if MPI.Query_thread() == MPI.THREAD_MULTIPLE or threading.current_thread() is threading.main_thread():
        comm.Abort(INTERRUPTED_STATUS)
    os._exit(INTERRUPTED_STATUS)  # the launcher then ends the others


def _end_all(comm: MPI.Comm, error: BaseException) -> None:
    """Tell of ``error`` and abort, unless another rank does so for this one."""
    if isinstance(error, KeyboardInterrupt):
        end_interrupted(comm)
    if not how_shared(error).speaks:
        return
    # A bug often shows on all ranks at once: rank 0 then ends the others before they say the same.
    time.sleep(min(1.0, 0.5 * comm.rank))
    if isinstance(error, InputError):
        _say(error)
    else:
        trace = "".join(traceback.format_exception(error)).rstrip()
        _say(f"rank {comm.rank} of {comm.size} failed\n{trace}")
    time.sleep(HEARD_S)
    comm.Abort(INPUT_ERROR_STATUS if isinstance(error, InputError) else 1)


def _say(words: object) -> None:
    sys.stdout.flush()
    # The process's own stream, as ranks other than 0 may have been told to be quiet.
    print(f"hydrabeam: error: {words}", file=sys.__stderr__, flush=True)
