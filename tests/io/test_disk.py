from __future__ import annotations

import resource
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.disk import check_space, write_computed, writing
from hydrabeam_mpi.io.hdf5 import new_hdf5


@contextmanager
def file_size_limit(size: int) -> Iterator[None]:
    """Let the system refuse larger files, as a full disk does."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def write_text(path: Path) -> None:
    path.write_text("x" * 20_000)


def write_large_hdf5(path: Path) -> None:
    with new_hdf5(path) as file:
        file["a"] = np.zeros(10_000)


def write_hdf5_in_pieces(path: Path) -> None:
    with new_hdf5(path) as file:
        for i in range(100):
            file[str(i)] = 1.0


@pytest.mark.parametrize("write", [write_text, write_large_hdf5, write_hdf5_in_pieces])
def test_a_full_disk_is_told(write: Callable[[Path], None], tmp_path: Path) -> None:
    folder = tmp_path / "partial"
    folder.mkdir()
    with pytest.raises(InputError) as raised, file_size_limit(10_000), writing(folder):
        write(folder / "a")
    assert str(raised.value) == (
        f"{tmp_path}: -o: cannot be written (File too large); make room, or choose a folder elsewhere"
    )


def test_other_failures_stay_what_they_are(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError), writing(tmp_path):
        (tmp_path / "none" / "a").write_text("")
    with pytest.raises(ZeroDivisionError), writing(tmp_path):
        1 / 0  # noqa: B018


def test_space_is_checked_in_time(tmp_path: Path) -> None:
    free = shutil.disk_usage(tmp_path).free
    check_space(tmp_path, free // 2)
    with pytest.raises(InputError) as raised:
        check_space(tmp_path / ".", 10**21)
    assert str(raised.value).startswith(f"{tmp_path.parent}: -o: needs at least 1 ZB, and its disk has ")


def write_much(folder: Path) -> None:
    (folder / "first").write_text("x")
    write_hdf5_in_pieces(folder / "posterior.h5")


def test_what_was_computed_is_kept_elsewhere(small_disk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    fill(small_disk)
    folder = small_disk / "partial"
    folder.mkdir()
    with pytest.raises(
        InputError, match=r"cannot be written \(No space left on device\): the result is kept in"
    ) as raised:
        write_computed(folder, write_much)
    (kept,) = tmp_path.glob("hydrabeam-*")
    assert str(raised.value).endswith(f"kept in {kept}; move it to where there is room")
    assert sorted(path.name for path in kept.iterdir()) == ["first", "posterior.h5"]


def test_what_cannot_be_kept_anywhere(small_disk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(small_disk))
    folder = small_disk / "partial"
    folder.mkdir()
    fill(small_disk)
    with pytest.raises(InputError, match=f"and neither can {small_disk}: what was computed is lost; make room"):
        write_computed(folder, write_much)


def fill(disk: Path) -> None:
    """Leave a few kB."""
    (disk / "filler").write_bytes(b"x" * (shutil.disk_usage(disk).free - 16_000))
