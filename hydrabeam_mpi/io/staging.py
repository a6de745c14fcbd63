"""Output folders that appear whole or not at all."""

from __future__ import annotations

import errno
import os
import re
import secrets
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from hydrabeam_mpi.errors import InputError

# Every finished folder has it: only a folder with this file is ever replaced.
RESULT_MARK = "provenance.json"
# What the disk says when it takes no more.
DISK_ERRORS = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EACCES}


class StagedDirectory:
    """A folder that is filled under a temporary name beside its place and renamed at the end.

    Only one process (rank 0) should create and publish it.

    Parameters
    ----------
    path : Path
        Where the folder shall appear.
    overwrite : bool
        Whether an earlier result is replaced; it stays until the new one is whole.
    inputs : iterable of Path
        What the result is made from, and which must not go with an earlier result.

    Attributes
    ----------
    partial : Path
        The folder to fill.

    Raises
    ------
    InputError
        If ``path`` exists and may not be replaced, or cannot be written.
    """

    def __init__(self, path: Path, overwrite: bool, inputs: Iterable[Path] = ()) -> None:
        self._asked, self._overwrite = path, overwrite
        try:
            self.path = path.resolve()
            self._check_free()
            self._check_holds_none_of(inputs)
            self.partial = self._beside("partial")
            self._new_parents = [parent for parent in self.path.parents if not parent.is_dir()]
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self.partial.mkdir()
        except OSError as error:
            raise self._refusal(
                f"cannot be written ({error.strerror})", "choose a folder that you may write"
            ) from error

    def publish(self) -> None:
        """Move the finished folder to its place; one that stood there is removed last.

        Raises
        ------
        InputError
            If it cannot be moved. It is then kept under its temporary name, and what stood in its place stays.
        """
        old = self._beside("old")
        try:
            self._check_free()
            if self.path.exists():
                self.path.rename(old)
            try:
                self.partial.rename(self.path)
            except OSError:
                if old.exists():
                    old.rename(self.path)
                raise
        except (OSError, InputError) as error:
            reason = error.strerror if isinstance(error, OSError) else error.message
            raise self._refusal(
                f"{reason}, now that the result is finished", f"the result is kept in {self.partial}"
            ) from error
        shutil.rmtree(old, ignore_errors=True)

    def discard(self) -> None:
        """Remove what has been written so far; any process may do so, also several at once."""
        shutil.rmtree(self.partial, ignore_errors=True)
        with suppress(OSError):
            for parent in self._new_parents:
                parent.rmdir()

    def _beside(self, role: str) -> Path:
        """Return a name that no other run has."""
        return self.path.with_name(f".{self.path.name}.{role}-{secrets.token_hex(4)}")

    def _check_free(self) -> None:
        """Make sure that nothing stands in the way, or else a result that may be replaced."""
        above = next((parent for parent in self.path.parents if parent.exists()), self.path)
        if not above.is_dir():
            raise self._refusal(f"cannot be written, as {above} is a file", "choose a folder that you may write")
        if not self.path.exists():
            return
        if not self._overwrite:
            raise self._refusal("exists already", "choose another folder or add --overwrite")
        if not self.path.is_dir():
            raise self._refusal("is not a folder", "choose another name")
        if any(self.path.iterdir()) and not (self.path / RESULT_MARK).is_file():
            raise self._refusal("is not an earlier result, so it is not replaced", "choose another folder")

    def _check_holds_none_of(self, inputs: Iterable[Path]) -> None:
        """Make sure that no input is lost with an earlier result."""
        for file in inputs:
            if self.path.exists() and file.resolve().is_relative_to(self.path):
                raise self._refusal(f"holds {file.name}, which the job reads", "choose another folder")

    def _refusal(self, message: str, remedy: str) -> InputError:
        return InputError(message, file=self._asked, field="-o", remedy=remedy)


@contextmanager
def writing(folder: Path) -> Iterator[None]:
    """Tell of a disk that takes no more as of wrong input.

    Raises
    ------
    InputError
        If one of `DISK_ERRORS` is at the root of what the block raises.
    """
    try:
        yield
    except Exception as error:
        number = _disk_error(error)
        if number is None:
            raise
        reason, remedy = os.strerror(number), "make room, or choose a folder elsewhere"
        raise InputError(f"cannot be written ({reason})", file=folder.parent, field="-o", remedy=remedy) from error


def _disk_error(error: BaseException | None) -> int | None:
    """Find one of `DISK_ERRORS` in a chain of exceptions, or in what HDF5 says while it closes a file."""
    while error:
        said = re.search(r"errno = (\d+)", str(error))
        number = getattr(error, "errno", None) or (int(said[1]) if said else None)
        if number in DISK_ERRORS:
            return number
        error = error.__cause__ or error.__context__
    return None
