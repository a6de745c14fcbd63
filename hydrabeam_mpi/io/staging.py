"""Output folders that appear whole or not at all, and replace nothing but earlier results."""

from __future__ import annotations

import logging
import os
import shutil
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.checksums import stamp_of
from hydrabeam_mpi.io.kept_rounds import latest_round, number_of, rounds_words, settle
from hydrabeam_mpi.io.leftovers import claim, clear_leftovers, new_name
from hydrabeam_mpi.io.manifest import MANIFEST, RUNNING, find_strangers, read_manifest, remove_result, write_manifest

logger = logging.getLogger(__name__)

NAMED_STRANGERS = 3
"""How many of the files that keep a folder from being replaced are named: a line has room for no more."""


class StagedDirectory:
    """A folder that is filled under a temporary name beside its place and renamed at the end.

    Only one process (rank 0) should create and publish it. What runs that were killed have left beside the place is
    removed first.

    Parameters
    ----------
    path : Path
        Where the folder shall appear.
    overwrite : bool
        Whether an earlier result is replaced; it stays until the new one is whole.
    inputs : iterable of Path
        What the result is made from: it must not go with an earlier result, nor change before the new one is
        published.
    kept : iterable of Path
        What else must not go with an earlier result.

    Attributes
    ----------
    partial : Path
        The folder to fill.

    Raises
    ------
    InputError
        If ``path`` exists and may not be replaced, or cannot be written.
    """

    def __init__(self, path: Path, overwrite: bool, inputs: Iterable[Path] = (), kept: Iterable[Path] = ()) -> None:
        inputs = tuple(inputs)
        self._lock: int | None = None
        self._asked, self._overwrite, self._kept = path, overwrite, (*inputs, *kept)
        self._stamps = {file: stamp_of(file) for file in inputs}
        try:
            self.path = Path(os.path.realpath(path))
            clear_leftovers(self.path)
            check_place(path, overwrite, self._kept)
            self.partial = new_name(self.path, "partial")
            self._new_parents = [parent for parent in self.path.parents if not parent.is_dir()]
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self.partial.mkdir()
        except OSError as error:
            raise _cannot_be_written(path, error) from error
        try:
            self._lock = claim(self.partial)
        except OSError as error:
            self.discard()
            raise _cannot_be_written(path, error) from error

    def __getstate__(self) -> dict[str, Any]:
        """Leave the lock to the process that made it."""
        return {**self.__dict__, "_lock": None}

    def publish(self) -> None:
        """Move the finished folder to its place; one that stood there is removed last.

        Raises
        ------
        InputError
            If an input has changed meanwhile, or the folder cannot be moved. It is then kept under its temporary name,
            and what stood in its place stays.
        """
        try:
            write_manifest(self.partial)
        except OSError as error:
            logger.warning("%s cannot be written (%s): --overwrite will not replace this result", MANIFEST, error)
        old = new_name(self.path, "old")
        try:
            self._check_inputs()
            check_place(self._asked, self._overwrite, self._kept)
            if self.path.exists():
                self.path.rename(old)
            try:
                self.partial.rename(self.path)
            except OSError:
                if old.exists():
                    old.rename(self.path)
                raise
        except (OSError, InputError) as error:
            self._release(self.partial)
            raise self._kept_aside(error) from error
        self._release(self.path)
        if old.exists() and not remove_result(old):
            logger.warning("of the earlier result not all could be removed: the rest is in %s", old)

    def leave(self, interrupted: bool) -> None:
        """End without a result: remove what has been written, except for the rounds of a loop that have ended.

        After a signal these, or the fit before the first, are published, as a result that says so. Else rounds stay
        where a later run finds them.
        """
        kept = latest_round(self.partial)
        if kept is None or not (interrupted or number_of(kept)):
            self.discard()
            return
        where, what = self.partial, rounds_words(kept)
        if interrupted:
            try:
                settle(self.partial)
                self.publish()
                where = self._asked
            except (OSError, InputError) as error:
                logger.warning("%s", error)
        logger.info("kept in %s: %s, from where the same command goes on", where, what)

    def discard(self) -> None:
        """Remove what has been written so far; any process may do so, also several at once."""
        shutil.rmtree(self.partial, ignore_errors=True)
        self._release(self.partial)
        with suppress(OSError):
            for parent in self._new_parents:
                parent.rmdir()

    def _release(self, folder: Path) -> None:
        """Let go of the lock."""
        with suppress(OSError):
            (folder / RUNNING).unlink()
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def _check_inputs(self) -> None:
        """Make sure that the inputs are those from which the result was made."""
        for file, stamp in self._stamps.items():
            now = stamp_of(file)
            if now != stamp:
                raise InputError(
                    f"was {'changed' if now else 'removed'} during the run, so that nobody can tell what was read",
                    file=file,
                    remedy="run again once it stays as it is",
                )

    def _kept_aside(self, error: OSError | InputError) -> InputError:
        """Tell why the finished result is not where it should be, and where it is."""
        where = f"the result is kept in {self.partial}"
        if isinstance(error, OSError):
            reason = f"{error.strerror}, now that the result is finished"
            return InputError(reason, file=self._asked, field="-o", remedy=where)
        if error.field == "-o":
            reason = f"{error.message}, now that the result is finished"
            return InputError(reason, file=error.file, field="-o", remedy=where)
        return InputError(error.message, file=error.file, remedy=f"{error.remedy}; {where}")


def write_folder(path: Path, fill: Callable[[Path], None], overwrite: bool = False, kept: Iterable[Path] = ()) -> None:
    """Let ``fill`` write a folder, which appears when all is in it; parameters and errors as of `StagedDirectory`."""
    staged = StagedDirectory(path, overwrite, kept=kept)
    try:
        fill(staged.partial)
    except BaseException:
        staged.discard()
        raise
    staged.publish()


def check_place(path: Path, overwrite: bool, kept: Iterable[Path] = ()) -> None:
    """Make sure that a result can appear at ``path``.

    Parameters
    ----------
    path : Path
    overwrite : bool
        Whether an earlier result may be replaced. It has a manifest, and nothing in it but what that lists.
    kept : iterable of Path
        Files that must not be in it.

    Raises
    ------
    InputError
        If something stands in the way.
    """
    try:
        place = Path(os.path.realpath(path))
        above = next((parent for parent in place.parents if parent.exists()), place)
        if not above.is_dir():
            raise _refusal(path, f"cannot be written, as {above} is a file", "choose a folder that you may write")
        if not os.path.lexists(place):
            return
        place.stat()
        if not overwrite:
            raise _refusal(path, "exists already", "choose another folder or add --overwrite")
        if not place.is_dir():
            raise _refusal(path, "is not a folder", "choose another name")
        _check_replaceable(path, place, kept)
    except OSError as error:
        raise _cannot_be_written(path, error) from error


def _check_replaceable(path: Path, place: Path, kept: Iterable[Path]) -> None:
    """Make sure that nothing but an earlier result is lost with a folder."""
    for file in kept:
        # Where a link leads, and the link itself.
        for named in (os.path.realpath(file), os.path.join(os.path.realpath(file.parent), file.name)):
            if Path(named).is_relative_to(place):
                raise _refusal(path, f"holds {file.name}, which the job reads", "choose another folder")
    if read_manifest(place) is None and any(place.iterdir()):
        message = f"is not an earlier result (it has no {MANIFEST} of one), so it is not replaced"
        raise _refusal(path, message, "choose another folder, or remove it yourself")
    strangers = find_strangers(place)
    if strangers:
        more = f" and {len(strangers) - NAMED_STRANGERS} more" if len(strangers) > NAMED_STRANGERS else ""
        what = ", ".join(strangers[:NAMED_STRANGERS]) + more
        message = f"holds what the earlier result did not, so it is not replaced: {what}"
        raise _refusal(path, message, "choose another folder, or move that elsewhere")


def _refusal(path: Path, message: str, remedy: str) -> InputError:
    return InputError(message, file=path, field="-o", remedy=remedy)


def _cannot_be_written(path: Path, error: OSError) -> InputError:
    return _refusal(path, f"cannot be written ({error.strerror})", "choose a folder that you may write")
