"""Full disks: detected before the work begins, and reported in one line if they fill up later."""

from __future__ import annotations

import errno
import os
import secrets
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.words import size

DISK_ERRORS = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EACCES, errno.EIO}
"""What the system says when a disk takes no more."""

REMEDY = "make room, or choose a folder elsewhere"


def check_space(folder: Path, needed: int) -> None:
    """Make sure that a disk has room for so many bytes.

    Raises
    ------
    InputError
        If it has less.
    """
    free = shutil.disk_usage(folder).free
    if free < needed:
        message = f"needs at least {size(needed)}, and its disk has {size(free)} left"
        raise InputError(message, file=folder.parent, field="-o", remedy=REMEDY)


@contextmanager
def writing(folder: Path) -> Iterator[None]:
    """Report a full disk as an `InputError`.

    Raises
    ------
    InputError
        If one of `DISK_ERRORS` is at the root of what the block raises.
    """
    try:
        yield
    except Exception as error:
        said = _disk_error(error)
        if said is None:
            raise
        raise InputError(f"cannot be written ({said})", file=folder.parent, field="-o", remedy=REMEDY) from error


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a hidden name beside ``path`` to write to; what is there takes its place, or vanishes with an error."""
    partial = path.with_name(f".{path.name}.partial-{secrets.token_hex(4)}")
    try:
        yield partial
        partial.replace(path)
    finally:
        with suppress(OSError):
            partial.unlink(missing_ok=True)


def write_computed(folder: Path, write: Callable[[Path], None]) -> None:
    """Write what has been computed; where the disk takes no more, into the system's folder for temporary files.

    Parameters
    ----------
    folder : Path
    write : callable
        Writes into the folder that it is given.

    Raises
    ------
    InputError
        If the disk takes no more. It says where what has been computed is, if anywhere.
    """
    try:
        with writing(folder):
            write(folder)
    except InputError as error:
        elsewhere = Path(tempfile.mkdtemp(prefix="hydrabeam-"))
        try:
            with writing(elsewhere):
                write(elsewhere)
        except InputError:
            shutil.rmtree(elsewhere, ignore_errors=True)
            message = f"{error.message}, and neither can {elsewhere.parent}: what was computed is lost"
            raise InputError(message, file=error.file, field=error.field, remedy=REMEDY) from error
        message = f"{error.message}: the result is kept in {elsewhere}"
        remedy = "move it to where there is room"
        raise InputError(message, file=error.file, field=error.field, remedy=remedy) from error


def _disk_error(error: BaseException | None) -> str | None:
    """Find one of `DISK_ERRORS` in a chain of exceptions, in the system's words."""
    while error:
        number = getattr(error, "errno", None)
        if number in DISK_ERRORS:
            return os.strerror(number)
        error = error.__cause__ or error.__context__
    return None
