"""`hydrabeam predict` and `correct` refuse in one line what they cannot apply; a beam alone is applied as it is."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import pytest
from mpi4py import MPI

from hydrabeam_mpi.cli import main
from hydrabeam_mpi.io.manifest import add_to_manifest
from tests.cli.conftest import OnRoot, Workspace, refusal


@pytest.fixture
def copy(result: Path, common_tmp_path: Path, on_root: OnRoot) -> Path:
    """A result that may be damaged."""
    return Path(on_root(lambda: shutil.copytree(result, common_tmp_path / "result")))


def test_a_result_of_a_beam_alone(result: Path, workspace: Workspace, on_root: OnRoot) -> None:
    """Basis, prior and hold-out are of the result, whatever the job says of them."""
    changes = {"basis": {"n_modes": 9, "k_max": 8, "m_max": 2}, "holdout": {"every": 2}, "prior": {"fraction": 0.5}}
    job = on_root(lambda: workspace.job(changes))
    out = workspace.folder / "out"
    assert main(["predict", str(result), str(job), "-o", str(out)]) == 0
    told = on_root(lambda: json.loads((out / "prediction.json").read_text()))
    assert told["n"] == 4 * 21
    summary = on_root(lambda: json.loads((result / "summary.json").read_text()))
    assert told["noise_only_chi2"] == pytest.approx(
        (summary["train_chi2"] + summary["heldout_chi2_noise_only"]) / 2, rel=1e-9
    )
    assert told["carried_over"] == told["not_carried_over"] == told["at_prior"] == []


def _empty(folder: Path) -> None:
    shutil.rmtree(folder)


def _without_posterior(folder: Path) -> None:
    (folder / "posterior.h5").unlink()


def _cut(folder: Path) -> None:
    path = folder / "posterior.h5"
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def _at(freq: float) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        with h5py.File(folder / "posterior.h5", "a") as file:
            file["channel_0000"].attrs["freq"] = freq

    return change


def _attribute(name: str, value: Any) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        with h5py.File(folder / "posterior.h5", "a") as file:
            file.attrs[name] = value

    return change


def _effects(content: Any) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        with h5py.File(folder / "posterior.h5", "a") as file:
            table = {"basis": json.loads(file.attrs["basis"]), "entries": content}
            file["effects"] = json.dumps(table)

    return change


def _looped(folder: Path) -> None:
    """Of a version that did not keep what beam and effects share."""
    (folder / "loop.json").write_text("{}")


def _damaged(damage: Callable[[Path], None], folder: Path) -> None:
    """Damage a result in a way that its manifest does not tell."""
    damage(folder)
    if (folder / "posterior.h5").exists():
        add_to_manifest(folder, ["posterior.h5"])


@pytest.mark.parametrize(
    ("damage", "told"),
    [
        (_empty, ("posterior.h5", "no such file", "name a folder written by 'hydrabeam infer'")),
        (_without_posterior, ("posterior.h5", "no such file")),
        (_cut, ("posterior.h5",)),
        (_at(131e6 + 2), ("job.toml", "[data] freqs", "no beam at 131.000000 MHz", "within 1 Hz of the result's")),
        (_attribute("polarization", "en"), ("job.toml", "[data] polarization", "the result is of 'en'")),
        (_attribute("basis", '{"kind": "shapelets"}'), ("posterior.h5", "unknown basis kind 'shapelets'")),
        (_looped, ("posterior.h5", "effects", "make the result again")),
        (_effects([{"kind": "antenna_gains"}]), ("posterior.h5", "effects, number 1", "make the result again")),
        (_effects([3]), ("posterior.h5", "effects, number 1", "is not understood")),
    ],
)
def test_what_cannot_be_applied(
    damage: Callable[[Path], None],
    told: tuple[str, ...],
    copy: Path,
    workspace: Workspace,
    on_root: OnRoot,
    comm: MPI.Comm,
    capfd: pytest.CaptureFixture[str],
) -> None:
    job = on_root(lambda: workspace.job())
    on_root(lambda: _damaged(damage, copy))
    out = workspace.folder / "out"
    assert main(["predict", str(copy), str(job), "-o", str(out)]) == 2
    line = refusal(capfd, comm)
    for part in told:
        assert part in line
    assert on_root(lambda: [path.name for path in workspace.folder.glob(".*")] == [] and not out.exists())


@pytest.mark.parametrize("command", ["predict", "correct"])
def test_a_result_that_has_changed_since_it_was_written(
    command: str, copy: Path, workspace: Workspace, on_root: OnRoot, comm: MPI.Comm, capfd: pytest.CaptureFixture[str]
) -> None:
    job = on_root(lambda: workspace.job())
    on_root(lambda: _attribute("telescope_name", "another")(copy))
    assert main([command, str(copy), str(job), "-o", str(workspace.folder / "out")]) == 2
    assert f"{copy / 'posterior.h5'}: has changed since manifest.json was written" in refusal(capfd, comm)


@pytest.mark.parametrize("command", ["predict", "correct"])
def test_the_result_itself_is_kept(
    command: str, copy: Path, workspace: Workspace, on_root: OnRoot, comm: MPI.Comm, capfd: pytest.CaptureFixture[str]
) -> None:
    job = on_root(lambda: workspace.job())
    assert main([command, str(copy), str(job), "-o", str(copy), "--overwrite"]) == 2
    assert "choose another folder" in refusal(capfd, comm)
    assert on_root(lambda: (copy / "posterior.h5").exists())


def test_nothing_to_correct_by(workspace: Workspace, comm: MPI.Comm, capfd: pytest.CaptureFixture[str]) -> None:
    missing = workspace.folder / "missing"
    assert main(["correct", str(missing), "-o", str(workspace.folder / "out")]) == 2
    assert f"{missing / 'posterior.h5'}: no such file" in refusal(capfd, comm)
