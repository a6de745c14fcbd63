"""Runs that are killed for good: what they leave, and what the next run makes of it."""

from __future__ import annotations

import json
import logging
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from hydrabeam_mpi.io.leftovers import RUNNING, claim, clear_leftovers, find_abandoned, new_name
from hydrabeam_mpi.io.manifest import write_manifest
from hydrabeam_mpi.io.staging import StagedDirectory

SOURCE = """
import sys, time
from pathlib import Path
from hydrabeam_mpi.io.staging import StagedDirectory
staged = StagedDirectory(Path(sys.argv[1]), overwrite=False)
(staged.partial / "half").write_text("half")
print(staged.partial, flush=True)
time.sleep(60)
"""


@pytest.fixture
def run(tmp_path: Path) -> Iterator[tuple[subprocess.Popen[str], Path]]:
    """A process that fills a folder for ``out``, and that folder."""
    with subprocess.Popen(
        [sys.executable, "-c", SOURCE, tmp_path / "out"], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout
        yield process, Path(process.stdout.readline().strip())
        process.kill()


def test_of_a_run_that_goes_on(run: tuple[subprocess.Popen[str], Path], tmp_path: Path) -> None:
    _, partial = run
    assert find_abandoned(tmp_path / "out") == []
    StagedDirectory(tmp_path / "out", overwrite=False).discard()
    assert (partial / "half").exists()


def test_of_a_run_that_was_killed(
    run: tuple[subprocess.Popen[str], Path], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    process, partial = run
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert find_abandoned(tmp_path / "out") == [partial]
    assert find_abandoned(tmp_path / "other") == []
    with caplog.at_level(logging.INFO):
        StagedDirectory(tmp_path / "out", overwrite=False).discard()
    assert caplog.messages == [f"removed {partial}, which a run that was killed had left"]
    assert [*tmp_path.iterdir()] == []


@pytest.mark.parametrize("change", [{"host": "elsewhere"}, {"pid": None, "host": None}])
def test_of_a_run_that_nobody_can_ask_after(
    change: dict[str, None], run: tuple[subprocess.Popen[str], Path], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    process, partial = run
    process.kill()
    process.wait()
    about = json.loads((partial / RUNNING).read_text())
    (partial / RUNNING).write_text(json.dumps(about | change))
    clear_leftovers(tmp_path / "out")
    assert caplog.messages == [f"{partial} is of another run, perhaps elsewhere: remove it once that has ended"]
    assert (partial / "half").exists()


def test_a_finished_result_is_no_leftover(
    run: tuple[subprocess.Popen[str], Path], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    process, partial = run
    write_manifest(partial)
    process.kill()
    process.wait()
    clear_leftovers(tmp_path / "out")
    assert caplog.messages == [f"{partial} is the finished result of an earlier run: move it or remove it"]
    assert (partial / "half").exists()


def earlier_result(place: Path) -> Path:
    place.mkdir()
    (place / "content").touch()
    write_manifest(place)
    return place


def test_a_result_that_was_moved_away_comes_back(tmp_path: Path) -> None:
    out = tmp_path / "out"
    earlier_result(new_name(out, "old"))
    clear_leftovers(out)
    assert [*tmp_path.iterdir()] == [out]
    assert (out / "content").exists()


def test_a_result_that_was_replaced_goes_but_for_what_was_not_its_own(tmp_path: Path) -> None:
    out = earlier_result(tmp_path / "out")
    one, other = (earlier_result(new_name(out, "old")) for _ in range(2))
    (other / "mine").touch()
    clear_leftovers(out)
    assert not one.exists()
    assert [path.name for path in other.iterdir()] == ["mine"]
    assert (out / "content").exists()


def test_while_a_run_goes_on_nothing_is_moved(run: tuple[subprocess.Popen[str], Path], tmp_path: Path) -> None:
    old = earlier_result(new_name(tmp_path / "out", "old"))
    clear_leftovers(tmp_path / "out")
    assert old.exists()
    assert not (tmp_path / "out").exists()


def test_names_that_only_look_alike_are_left_alone(tmp_path: Path) -> None:
    for name in (".out.partial-notes", ".outer.partial-01234567", ".out.partial-012345678", ".o.t.partial-01234567"):
        (tmp_path / name).mkdir()
    before = sorted(tmp_path.iterdir())
    clear_leftovers(tmp_path / "out")
    clear_leftovers(tmp_path / "o.t" / "nowhere" / "out")
    assert sorted(tmp_path.iterdir()) == before


def test_a_folder_is_claimed_once(tmp_path: Path) -> None:
    folder = new_name(tmp_path / "out", "partial")
    folder.mkdir()
    claim(folder)
    clear_leftovers(tmp_path / "out")
    assert folder.exists()
    shutil.rmtree(folder)
