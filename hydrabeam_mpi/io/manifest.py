"""``manifest.json``: which files a result consists of, so that nothing else is ever removed with it.

It says that the folder is a result of this program, and has the checksum of every file of it but its own.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from hydrabeam_mpi.io.checksums import checksum
from hydrabeam_mpi.io.disk import replacing

MANIFEST = "manifest.json"
RESULT_OF = "hydrabeam_mpi"
RUNNING = ".running"
"""File in a folder that a run fills; see `hydrabeam_mpi.io.leftovers`."""


def write_manifest(folder: Path) -> None:
    """List all files of a finished folder."""
    files, _ = _content(folder)
    _write(folder, {name: checksum(folder / name) for name in files})


def add_to_manifest(folder: Path, names: Iterable[str]) -> None:
    """List files that have been added to a result, or written anew; a folder without a manifest stays so."""
    listed = read_manifest(folder)
    if listed is not None:
        _write(folder, {**listed, **{name: checksum(folder / name) for name in names}})


def read_manifest(folder: Path) -> dict[str, str] | None:
    """Return the checksums of a result's files by name; None where the folder is no result with a manifest."""
    try:
        table = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    if not isinstance(table, dict) or table.get("result_of") != RESULT_OF:
        return None
    files = table.get("files")
    return files if isinstance(files, dict) else None


def find_strangers(folder: Path) -> list[str]:
    """Name what a result's manifest does not list, and what has changed since.

    Raises
    ------
    OSError
        If not all of it can be read.
    """
    files, folders = _content(folder)
    listed = _listed_within(folder)
    expected = {str(parent) for name in listed for parent in Path(name).parents}
    said = [f"{name} (added)" for name in folders if name not in expected]
    for name in files:
        if name not in listed or (folder / name).is_symlink():
            said.append(f"{name} (added)")
        elif checksum(folder / name) != listed[name]:
            said.append(f"{name} (changed)")
    return said


def remove_result(folder: Path) -> bool:
    """Remove the files that a result's manifest lists and the folders that are empty then; tell whether all is gone."""
    listed = _listed_within(folder)
    files, folders = _content(folder)
    with suppress(OSError):
        for name in [name for name in files if name in listed]:
            (folder / name).unlink(missing_ok=True)
        for name in (RUNNING, MANIFEST):
            (folder / name).unlink(missing_ok=True)
        for name in sorted(folders, reverse=True):
            (folder / name).rmdir()
        folder.rmdir()
    return not folder.exists()


def _listed_within(folder: Path) -> dict[str, str]:
    """Return the checksums of a result's files, those of results within it by their own manifests.

    These may have changed since: a report is made in one of them.
    """
    listed = read_manifest(folder) or {}
    for part in [Path(name).parent for name in listed if Path(name).name == MANIFEST]:
        within = read_manifest(folder / part)
        if within is not None:
            listed |= {str(part / name): told for name, told in within.items()}
            listed[str(part / MANIFEST)] = checksum(folder / part / MANIFEST)
    return listed


def _content(folder: Path) -> tuple[list[str], list[str]]:
    """Return the names of all files (and links) and of all folders below one, but for the manifest and the lock."""

    def fail(error: OSError) -> None:
        raise error

    files: list[str] = []
    folders: list[str] = []
    for place, below, here in os.walk(folder, onerror=fail):
        relative = Path(place).relative_to(folder)
        links = [name for name in below if (Path(place) / name).is_symlink()]
        folders += [str(relative / name) for name in below if name not in links]
        files += [str(relative / name) for name in (*here, *links)]
    return sorted({*files} - {MANIFEST, RUNNING}), sorted(folders)


def _write(folder: Path, files: dict[str, str]) -> None:
    with replacing(folder / MANIFEST) as partial:
        partial.write_text(json.dumps({"result_of": RESULT_OF, "files": files}, indent=1) + "\n", encoding="utf-8")
