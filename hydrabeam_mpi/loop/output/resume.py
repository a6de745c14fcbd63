"""Resuming an earlier run of the same loop, and keeping rounds for a later run to resume."""

from __future__ import annotations

import json
import logging
import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomli_w

from hydrabeam_mpi.config import Job
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.fit.clock import Clock
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.error_scale import error_scale
from hydrabeam_mpi.io.kept_rounds import latest_round, number_of, origin_of, rounds_words, take_over
from hydrabeam_mpi.io.leftovers import find_abandoned
from hydrabeam_mpi.loop.output.amendment import amended_job
from hydrabeam_mpi.loop.output.checkpoint import keep_round, restore_round
from hydrabeam_mpi.loop.output.record import make_record
from hydrabeam_mpi.loop.selection.history import History
from hydrabeam_mpi.mpi import together
from hydrabeam_mpi.terminal.progress import say

logger = logging.getLogger(__name__)


def find_earlier(job: Job, out: Path) -> Path | None:
    """Find the round from which to go on: of a loop of this job that was ended, the one that came furthest.

    In the result that it left in ``out``, or beside it where it could leave none. Rounds of other jobs stay where they
    are. Serial.
    """
    place, found = Path(os.path.realpath(out)), []
    for folder in (place, *find_abandoned(place)):
        kept = latest_round(folder)
        if kept is None:
            continue
        if origin_of(kept).get("job") == job.model_dump(mode="json", exclude_none=True):
            found.append(kept)
        elif folder != place:
            logger.warning("%s has rounds of another job, whose run was killed: they stay there", folder)
    return max(found, key=number_of, default=None)


@dataclass(frozen=True)
class Keeper:
    """Keeps the rounds of a run, and takes those of an earlier one.

    Attributes
    ----------
    context : FitContext
    folder : Path
        That is filled.
    skipped, conventions
        As of `make_record`.
    clock : Clock
    about : callable
        Gives the provenance, on rank 0.
    """

    context: FitContext
    folder: Path
    skipped: list[tuple[str, str]]
    conventions: dict[str, Any]
    clock: Clock
    about: Callable[[], dict[str, Any]]

    def go_on(self, earlier: Path | None, out: Path, overwrite: bool) -> History | None:
        """Return the history that is kept in ``earlier``; None to begin anew.

        Collective: all ranks of the grid.

        Raises
        ------
        InputError
            On all ranks, if it is damaged, or a result in ``out`` is of other data and must not be overwritten.
        """
        with together(self.context.grid.world):
            if earlier is not None and self.context.grid.is_world_root and not self._is_same(earlier, out, overwrite):
                earlier = None
        earlier = self.context.grid.world.bcast(earlier)
        if earlier is None:
            return None
        kept = restore_round(self.context, earlier)
        for phase, seconds in kept.seconds.items():
            self.clock.seconds[phase] = self.clock.seconds.get(phase, 0.0) + seconds
        with together(self.context.grid.world):
            if self.context.grid.is_world_root:
                take_over(earlier, self.folder)
                owner = earlier.parent.parent
                if owner != Path(os.path.realpath(out)):
                    shutil.rmtree(owner, ignore_errors=True)
                say(f"going on after {rounds_words(earlier)} of an earlier run, kept in {owner}")
        return kept.history

    def _is_same(self, earlier: Path, out: Path, overwrite: bool) -> bool:
        """Tell whether a round follows from what is here now."""
        then, now, owner = origin_of(earlier), self.about(), earlier.parent.parent
        changed = [name for name in ("sha256", "versions") if then.get(name) != now[name]]
        if not changed:
            return True
        what = "other data" if "sha256" in changed else "other versions of the program or of what it uses"
        if owner == Path(os.path.realpath(out)) and not overwrite:
            message = f"has the rounds of a loop that was interrupted, but of {what}"
            raise InputError(message, file=out, field="-o", remedy="choose another folder or add --overwrite")
        logger.warning("%s has rounds of %s: beginning anew", owner, what)
        return False

    def __call__(self, history: History) -> None:
        """Keep a history whose last round has ended, or the first not yet. Collective: all ranks of the grid."""
        record = make_record(self.context, history, self.skipped, self.conventions, None, interrupted=True)
        scale = error_scale(self.context, history.last.fitted)
        texts = {}
        with together(self.context.grid.world):
            if self.context.grid.is_world_root:
                about, job = self.about(), self.context.problem.job
                texts = {
                    "job.toml": tomli_w.dumps(about["job"]),
                    "provenance.json": json.dumps(about, indent=2) + "\n",
                    **loop_texts(
                        {**record, "seconds": self.clock.seconds},
                        amended_job(job, history.last.fitted, self.context.setup, scale),
                    ),
                }
        keep_round(self.context, history, self.folder, texts, self.clock.seconds)


def loop_texts(record: dict[str, Any], amended: Job) -> dict[str, str]:
    """Return the files that tell what the loop found and the job that has it, by name."""
    return {
        "loop.json": json.dumps(record, indent=1, allow_nan=False) + "\n",
        "amended.toml": tomli_w.dumps(amended.model_dump(mode="json", exclude_none=True)),
    }
