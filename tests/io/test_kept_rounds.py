"""Rounds on disk: the last one is kept whole, and nothing else is read from it than what was written."""

from __future__ import annotations

import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.fit.state import Ended
from hydrabeam_mpi.io.kept_rounds import (
    READABLE,
    drop_rounds,
    latest_round,
    new_round,
    number_of,
    read_object,
    take_over,
    write_object,
)
from hydrabeam_mpi.io.staging import StagedDirectory


def keep(folder: Path, number: int) -> None:
    with new_round(folder, number) as place:
        for name in READABLE:
            (place / name).write_text(f"{name} of {number}")


def fail_to_keep(folder: Path) -> None:
    with new_round(folder, 3) as place:
        (place / "part").touch()
        raise KeyboardInterrupt


def test_the_last_round_that_is_whole_is_kept(tmp_path: Path) -> None:
    assert latest_round(tmp_path) is None
    keep(tmp_path, 1)
    keep(tmp_path, 2)
    with pytest.raises(KeyboardInterrupt):
        fail_to_keep(tmp_path)
    kept = latest_round(tmp_path)
    assert kept is not None
    assert (number_of(kept), (kept / "loop.json").read_text()) == (2, "loop.json of 2")
    with new_round(tmp_path, 2) as place:
        (place / "loop.json").write_text("another")
    assert (kept / "loop.json").read_text() == "another"
    assert sorted(path.name for path in kept.parent.iterdir()) == ["0002"]
    for name in READABLE:
        (kept / name).write_text(f"{name} of 2")
    (tmp_path / "later").mkdir()
    take_over(kept, tmp_path / "later")
    keep(tmp_path / "later", 10)
    assert sorted(path.name for path in (tmp_path / "later" / "rounds").iterdir()) == ["0010"]
    drop_rounds(tmp_path)
    assert latest_round(tmp_path) is None


@pytest.mark.parametrize("interrupted", [False, True])
def test_the_fit_before_the_first_round_is_left_after_a_signal(interrupted: bool, tmp_path: Path) -> None:
    """Else nothing is: no round has ended."""
    staged = StagedDirectory(tmp_path / "out", overwrite=False)
    keep(staged.partial, 0)
    staged.leave(interrupted)
    assert (tmp_path / "out" / "loop.json").exists() == interrupted
    assert list(tmp_path.iterdir()) == [tmp_path / "out"] * interrupted


@pytest.mark.parametrize("interrupted", [False, True])
def test_a_folder_with_rounds_is_left(interrupted: bool, tmp_path: Path) -> None:
    staged = StagedDirectory(tmp_path / "out", overwrite=False)
    keep(staged.partial, 1)
    staged.leave(interrupted)
    where = tmp_path / "out" if interrupted else staged.partial
    assert [*tmp_path.iterdir()] == [where]
    assert latest_round(where) == where / "rounds" / "0001"
    assert (where / "loop.json").exists() == interrupted
    staged.leave(interrupted)
    assert latest_round(where) is not None


def test_a_folder_without_rounds_goes(tmp_path: Path) -> None:
    staged = StagedDirectory(tmp_path / "out", overwrite=False)
    (staged.partial / "rounds" / ".new").mkdir(parents=True)
    staged.leave(interrupted=True)
    assert not [*tmp_path.iterdir()]


class _Evil:
    def __reduce__(self) -> tuple[Any, ...]:
        return print, ("anything",)


class _Attribute:
    """What is written as an attribute of something."""

    def __init__(self, of: Any, name: str) -> None:
        self.of = of, name

    def __reduce__(self) -> tuple[Any, ...]:
        return getattr, self.of


def test_members_of_enumerations_are_read_as_any_python_writes_them(tmp_path: Path) -> None:
    write_object(tmp_path / "value", [Ended.STUCK, _Attribute(Ended, "STUCK")])
    assert read_object(tmp_path / "value") == [Ended.STUCK, Ended.STUCK]


@pytest.mark.parametrize(
    "value", [_Evil(), _Attribute(np.ndarray, "tofile"), np.linalg.inv, json.loads, {"a": [pickle.Unpickler]}]
)
def test_nothing_but_our_own_objects_are_read(value: Any, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    write_object(tmp_path / "value", value)
    with pytest.raises(InputError, match=r"value\.object: cannot be read \(.* has no business here\)"):
        read_object(tmp_path / "value")
    assert not capfd.readouterr().out


def test_damaged_objects_are_refused(tmp_path: Path) -> None:
    write_object(tmp_path / "value", [np.arange(3.0), np.float64(2), {"a": "b"}])
    array, number, table = read_object(tmp_path / "value")
    np.testing.assert_array_equal(array, np.arange(3.0))
    assert (number, table) == (2, {"a": "b"})
    path = tmp_path / "value.object"
    content = path.read_bytes()
    for damaged in (content[:-1], b"", content[:40] + b"x" + content[41:]):
        path.write_bytes(damaged)
        with pytest.raises(InputError, match="its checksum does not match"):
            read_object(tmp_path / "value")
