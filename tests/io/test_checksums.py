from __future__ import annotations

import hashlib
import os
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from hydrabeam_mpi.io.checksums import checksum, stamp_of


def test_checksum_of_a_file_is_that_of_sha256sum(tmp_path: Path) -> None:
    path = tmp_path / "a"
    # Longer than what is read at once, and not a multiple of it.
    path.write_bytes(bytes(range(256)) * (5 * 2**22 // 512) + b"end")
    said = subprocess.run(["sha256sum", path], capture_output=True, text=True, check=True).stdout
    assert checksum(path) == said.split()[0]


def test_checksum_of_a_folder_is_that_of_its_files_in_order(tmp_path: Path) -> None:
    folder = tmp_path / "data.ms"
    (folder / "table").mkdir(parents=True)
    (folder / "empty").mkdir()
    parts = {"table/b": b"second", "a": b"first", "table/c": b"third"}
    for name, part in parts.items():
        (folder / name).write_bytes(part)
    assert checksum(folder) == hashlib.sha256(b"firstsecondthird").hexdigest()
    (folder / "table" / "b").write_bytes(b"changed")
    assert checksum(folder) != hashlib.sha256(b"firstsecondthird").hexdigest()


def append(path: Path) -> None:
    with path.open("ab") as file:
        file.write(b"more")


def replace_by_a_copy(path: Path) -> None:
    copy = path.with_name("copy")
    copy.write_bytes(path.read_bytes())
    times = path.stat()
    os.utime(copy, ns=(times.st_atime_ns, times.st_mtime_ns))
    copy.replace(path)


def write_in_place(path: Path) -> None:
    later = path.stat().st_mtime_ns + 1
    path.write_bytes(path.read_bytes()[::-1])
    os.utime(path, ns=(later, later))


@pytest.mark.parametrize("change", [append, replace_by_a_copy, write_in_place, Path.unlink])
@pytest.mark.parametrize("of_folder", [False, True])
def test_a_stamp_changes_with_its_file(change: Callable[[Path], None], of_folder: bool, tmp_path: Path) -> None:
    folder = tmp_path / "data.ms"
    (folder / "sub").mkdir(parents=True)
    file = folder / "sub" / "table"
    file.write_bytes(b"visibilities")
    stamped = folder if of_folder else file
    before = stamp_of(stamped)
    file.read_bytes()
    assert stamp_of(stamped) == before is not None
    change(file)
    assert stamp_of(stamped) != before


def test_locks_of_a_reader_are_no_change(tmp_path: Path) -> None:
    (tmp_path / "table.f0").touch()
    (tmp_path / "table.lock").touch()
    before = stamp_of(tmp_path)
    append(tmp_path / "table.lock")
    assert stamp_of(tmp_path) == before
