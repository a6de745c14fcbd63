from __future__ import annotations

import errno
import json
import pickle
from collections.abc import Callable
from pathlib import Path

import pytest

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.staging import StagedDirectory


def fill(staged: StagedDirectory, text: str) -> None:
    (staged.partial / "sub").mkdir()
    (staged.partial / "sub" / "content").write_text(text)


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


@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("file", {False: "exists already", True: "is not a folder"}),
        ("folder", {False: "exists already", True: "is not an earlier result (it has no manifest.json of one), so"}),
        ("file/below", {False: "file is a file; choose", True: "file is a file; choose"}),
        ("file/far/below", {False: "file is a file; choose", True: "file is a file; choose"}),
        ("x" * 300, {False: "File name too long", True: "File name too long"}),
        (".", {False: "exists already", True: "is not an earlier result"}),
        ("/", {False: "exists already", True: "is not an earlier result"}),
        ("loop", dict.fromkeys((False, True), "cannot be written (Too many levels of symbolic links); choose")),
        ("loop/below", dict.fromkeys((False, True), "cannot be written (")),
    ],
)
def test_refused(overwrite: bool, name: str, words: dict[bool, str], tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "precious").touch()
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(InputError) as raised:
        StagedDirectory(tmp_path / name, overwrite)
    assert str(raised.value).startswith(f"{tmp_path / name}: -o: ")
    assert words[overwrite] in str(raised.value)
    assert raised.value.remedy
    assert sorted(tmp_path.rglob("*")) == before


def test_a_result_that_holds_an_input_is_not_replaced(tmp_path: Path) -> None:
    out = result(tmp_path / "out")
    (tmp_path / "link").symlink_to(out / "sub" / "content")
    for name in ("out/sub/content", "link"):
        for where in ("inputs", "kept"):
            with pytest.raises(InputError, match=r"out: -o: holds (content|link), which the job reads; choose another"):
                StagedDirectory(out, overwrite=True, **{where: [tmp_path / "elsewhere", tmp_path / name]})
    # What only begins alike is elsewhere.
    StagedDirectory(out, overwrite=True, inputs=[tmp_path / "out.uvh5"]).discard()
    assert content(out) == "old"


def add_file(out: Path) -> str:
    (out / "sub" / "notes.txt").touch()
    return "sub/notes.txt (added)"


def add_folder(out: Path) -> str:
    (out / "notes").mkdir()
    return "notes (added)"


def add_link(out: Path) -> str:
    (out / "link").symlink_to(out.parent)
    return "link (added)"


def put_a_link_in_place(out: Path) -> str:
    (out / "sub" / "content").rename(out.parent / "content")
    (out / "sub" / "content").symlink_to(out.parent / "content")
    return "sub/content (added)"


def change_file(out: Path) -> str:
    (out / "sub" / "content").write_text("mine")
    return "sub/content (changed)"


def add_many(out: Path) -> str:
    for number in range(5):
        (out / f"a{number}").touch()
    return "a0 (added), a1 (added), a2 (added) and 2 more"


STRANGERS = (add_file, add_folder, add_link, put_a_link_in_place, change_file, add_many)


@pytest.mark.parametrize("change", STRANGERS)
def test_what_a_result_did_not_hold_is_never_removed(change: Callable[[Path], str], tmp_path: Path) -> None:
    out = result(tmp_path / "out")
    said = change(out)
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(InputError) as raised:
        StagedDirectory(out, overwrite=True)
    assert str(raised.value) == (
        f"{out}: -o: holds what the earlier result did not, so it is not replaced: {said}; "
        "choose another folder, or move that elsewhere"
    )
    assert sorted(tmp_path.rglob("*")) == before


def test_what_came_into_a_result_during_the_run(tmp_path: Path) -> None:
    out = result(tmp_path / "out")
    staged = StagedDirectory(out, overwrite=True)
    fill(staged, "new")
    add_file(out)
    with pytest.raises(
        InputError, match=r"notes.txt \(added\), now that the result is finished; the result is kept in"
    ):
        staged.publish()
    assert (out / "sub" / "notes.txt").exists()
    assert content(staged.partial) == "new"


@pytest.mark.parametrize("text", ["{}", "[]", "", '{"name": "an app"}', '{"result_of": "hydrabeam_mpi"}'])
def test_a_manifest_of_something_else(text: str, tmp_path: Path) -> None:
    folder = tmp_path / "thesis"
    folder.mkdir()
    (folder / "manifest.json").write_text(text)
    (folder / "provenance.json").write_text("{}")
    with pytest.raises(InputError, match="is not an earlier result"):
        StagedDirectory(folder, overwrite=True)


def test_a_manifest_reaches_nothing_outside(tmp_path: Path) -> None:
    out = result(tmp_path / "out")
    (tmp_path / "precious").touch()
    manifest = json.loads((out / "manifest.json").read_text())
    manifest["files"]["../precious"] = "0" * 64
    (out / "manifest.json").write_text(json.dumps(manifest))
    staged = StagedDirectory(out, overwrite=True)
    fill(staged, "new")
    staged.publish()
    assert (tmp_path / "precious").exists()


def remove(path: Path) -> None:
    path.unlink()


def change(path: Path) -> None:
    path.write_text("other data")


@pytest.mark.parametrize(("how", "word"), [(remove, "removed"), (change, "changed")])
def test_inputs_that_change_during_the_run(how: Callable[[Path], None], word: str, tmp_path: Path) -> None:
    data, job = tmp_path / "data.uvh5", tmp_path / "job.toml"
    data.touch()
    job.touch()
    staged = StagedDirectory(tmp_path / "out", overwrite=False, inputs=[data], kept=[job])
    fill(staged, "new")
    change(job)
    how(data)
    with pytest.raises(InputError) as raised:
        staged.publish()
    assert str(raised.value) == (
        f"{data}: was {word} during the run, so that nobody can tell what was read; "
        f"run again once it stays as it is; the result is kept in {staged.partial}"
    )
    assert content(staged.partial) == "new"
    assert not (tmp_path / "out").exists()


def test_a_copy_for_another_process_has_no_lock(tmp_path: Path) -> None:
    staged = StagedDirectory(tmp_path / "out", overwrite=False)
    copy = pickle.loads(pickle.dumps(staged))
    copy.discard()
    assert not staged.partial.exists()
    staged.discard()
