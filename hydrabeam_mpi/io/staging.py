"""Output folders that appear whole or not at all."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from hydrabeam_mpi.errors import InputError


class StagedDirectory:
    """A folder that is filled under a temporary name beside its place and renamed at the end.

    Only one process (rank 0) should create, publish or discard it.

    Parameters
    ----------
    path : Path
        Where the folder shall appear.
    overwrite : bool
        Whether an existing folder is replaced; it stays until the new one is whole.

    Raises
    ------
    InputError
        If ``path`` exists and may not be replaced, or cannot be written.
    """

    def __init__(self, path: Path, overwrite: bool) -> None:
        self.path = path.resolve()
        self.partial = self.path.with_name(f".{self.path.name}.partial-{os.getpid()}")
        if self.path.exists() and not overwrite:
            raise InputError("exists already", file=path, field="-o", remedy="choose another folder or add --overwrite")
        if self.path.exists() and not self.path.is_dir():
            raise InputError("is a file, not a folder", file=path, field="-o", remedy="choose another folder")
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self.partial.mkdir()
        except OSError as error:
            raise InputError(
                f"cannot be written ({error.strerror})", file=path, field="-o", remedy="choose a folder that you may write"
            ) from error

    def publish(self) -> None:
        """Move the finished folder to its place; one that stood there is removed last."""
        old = self.path.with_name(f".{self.path.name}.old-{os.getpid()}")
        if self.path.exists():
            self.path.rename(old)
        self.partial.rename(self.path)
        shutil.rmtree(old, ignore_errors=True)

    def discard(self) -> None:
        """Remove what has been written so far."""
        shutil.rmtree(self.partial, ignore_errors=True)
