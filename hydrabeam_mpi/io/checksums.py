"""Whether files have changed: checksums of their content, and quick stamps (size, time, inode)."""

from __future__ import annotations

import hashlib
from pathlib import Path

Stamp = tuple[tuple[str, int, int, int], ...]
"""Of each file below a path: its name, bytes, time of its last change (ns) and inode."""

WRITTEN_BY_READING = ("table.lock",)
"""Files of a measurement set that casacore writes to also where it only reads."""


def checksum(path: Path) -> str:
    """Return the SHA-256 of a file, or of all files of a folder in order of name."""
    digest = hashlib.sha256()
    for file in _files_of(path):
        with file.open("rb") as stream:
            while block := stream.read(1 << 22):
                digest.update(block)
    return digest.hexdigest()


def stamp_of(path: Path) -> Stamp | None:
    """Return what changes when a file, or a file of a folder, is written to or replaced; None where it is gone."""
    try:
        found = ((file.relative_to(path), file.stat()) for file in _files_of(path))
        return tuple(
            (str(name), about.st_size, about.st_mtime_ns, about.st_ino)
            for name, about in found
            if name.name not in WRITTEN_BY_READING
        )
    except OSError:
        return None


def _files_of(path: Path) -> list[Path]:
    """List the files of a folder in order of name; of a file that file alone."""
    return [file for file in sorted(path.rglob("*")) if file.is_file()] if path.is_dir() else [path]
