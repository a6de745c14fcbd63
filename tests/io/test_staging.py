from __future__ import annotations

import errno
import resource
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np
import pytest

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.staging import RESULT_MARK, StagedDirectory, writing


def fill(staged: StagedDirectory, text: str) -> None:
    (staged.partial / "sub").mkdir()
    (staged.partial / "sub" / "content").write_text(text)
    (staged.partial / RESULT_MARK).write_text("{}")


def result(path: Path, text: str = "old") -> Path:
    staged = StagedDirectory(path, overwrite=False)
    fill(staged, text)
    staged.publish()
    return path


def content(path: Path) -> str:
    return (path / "sub" / "content").read_text()


def test_appears_whole(tmp_path: Path) -> None:
    out = tmp_path / "out"
    staged = StagedDirectory(out, overwrite=False)
    fill(staged, "new")
    assert not out.exists()
    staged.publish()
    assert content(out) == "new"
    assert [*tmp_path.iterdir()] == [out]
    assert out.stat().st_mode == (tmp_path / "out" / "sub").stat().st_mode


def test_vanishes_with_the_folders_made_for_it(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    staged = StagedDirectory(tmp_path / "there" / "not" / "yet" / "out", overwrite=False)
    fill(staged, "new")
    staged.discard()
    assert [*tmp_path.rglob("*")] == [tmp_path / "there"]
    staged.discard()


def test_discard_keeps_what_others_put_into_new_folders(tmp_path: Path) -> None:
    staged = StagedDirectory(tmp_path / "new" / "out", overwrite=False)
    (tmp_path / "new" / "other").touch()
    staged.discard()
    assert [*tmp_path.rglob("*")] == [tmp_path / "new", tmp_path / "new" / "other"]


def test_discard_after_publish_removes_nothing(tmp_path: Path) -> None:
    staged = StagedDirectory(tmp_path / "out", overwrite=False)
    fill(staged, "new")
    staged.publish()
    staged.discard()
    assert content(tmp_path / "out") == "new"


def test_overwrite_keeps_the_old_result_until_the_new_is_whole(tmp_path: Path) -> None:
    out = result(tmp_path / "out")
    staged = StagedDirectory(out, overwrite=True)
    fill(staged, "new")
    assert content(out) == "old"
    staged.publish()
    assert content(out) == "new"
    assert [*tmp_path.iterdir()] == [out]


def test_overwrite_of_an_empty_folder(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    staged = StagedDirectory(tmp_path / "out", overwrite=True)
    fill(staged, "new")
    staged.publish()
    assert content(tmp_path / "out") == "new"


def test_overwrite_through_a_link_replaces_what_it_points_to(tmp_path: Path) -> None:
    real = result(tmp_path / "real")
    (tmp_path / "link").symlink_to(real)
    staged = StagedDirectory(tmp_path / "link", overwrite=True)
    fill(staged, "new")
    staged.publish()
    assert (tmp_path / "link").is_symlink()
    assert content(real) == "new"


def test_a_result_that_cannot_be_moved_is_kept_as_is_the_old_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = result(tmp_path / "out")
    staged = StagedDirectory(out, overwrite=True)
    fill(staged, "new")
    rename = Path.rename

    def refuse_new(path: Path, target: Path) -> Path:
        if path == staged.partial:
            raise OSError(errno.ESTALE, "Stale file handle")
        return rename(path, target)

    monkeypatch.setattr(Path, "rename", refuse_new)
    with pytest.raises(InputError, match=r"out: -o: Stale file handle, now that .* is kept in .*partial"):
        staged.publish()
    assert content(out) == "old"
    assert content(staged.partial) == "new"
    assert sorted(tmp_path.iterdir()) == [staged.partial, out]


def test_two_runs_into_one_folder(tmp_path: Path) -> None:
    out = tmp_path / "out"
    first, second = StagedDirectory(out, overwrite=False), StagedDirectory(out, overwrite=False)
    assert first.partial != second.partial
    fill(first, "first")
    fill(second, "second")
    first.publish()
    with pytest.raises(InputError, match="exists already, now that the result is finished; the result is kept in "):
        second.publish()
    assert content(out) == "first"
    assert content(second.partial) == "second"


def test_a_leftover_of_a_killed_run_is_in_nobodys_way(tmp_path: Path) -> None:
    fill(StagedDirectory(tmp_path / "out", overwrite=False), "killed")
    assert content(result(tmp_path / "out", "new")) == "new"


@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("file", {False: "exists already", True: "is not a folder"}),
        ("folder", {False: "exists already", True: "is not an earlier result, so it is not replaced"}),
        ("file/below", {False: "file is a file; choose", True: "file is a file; choose"}),
        ("file/far/below", {False: "file is a file; choose", True: "file is a file; choose"}),
        ("x" * 300, {False: "File name too long", True: "File name too long"}),
        (".", {False: "exists already", True: "is not an earlier result"}),
        ("/", {False: "exists already", True: "is not an earlier result"}),
    ],
)
def test_refused(overwrite: bool, name: str, words: dict[bool, str], tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "precious").touch()
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(InputError) as raised:
        StagedDirectory(tmp_path / name, overwrite)
    assert str(raised.value).startswith(f"{tmp_path / name}: -o: ")
    assert words[overwrite] in str(raised.value)
    assert raised.value.remedy
    assert sorted(tmp_path.rglob("*")) == before


def test_a_result_that_holds_an_input_is_not_replaced(tmp_path: Path) -> None:
    out = result(tmp_path / "out")
    inside = tmp_path / "out" / "sub" / "*.uvh5"
    with pytest.raises(InputError, match=r"out: -o: holds \*.uvh5, which the job reads; choose another folder"):
        StagedDirectory(out, overwrite=True, inputs=[tmp_path / "elsewhere", inside])
    # What only begins alike is elsewhere.
    StagedDirectory(out, overwrite=True, inputs=[tmp_path / "out.uvh5"]).discard()
    assert content(out) == "old"


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
    with h5py.File(path, "w") as file:
        file["a"] = np.zeros(10_000)


def write_hdf5_in_pieces(path: Path) -> None:
    """Fails while the file is closed, with an error that does not have the system's number."""
    with h5py.File(path, "w") as file:
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
