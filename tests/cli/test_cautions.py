"""What a user should not overlook about the data: one line on the console, and the same words in the summary."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from typing import Any

import h5py
import numpy as np
import pytest
from mpi4py import MPI

from hydrabeam_mpi.cli import main
from tests.cli.conftest import OnRoot, Workspace

pytestmark = pytest.mark.mpi


def cautions(capfd: pytest.CaptureFixture[str], comm: MPI.Comm) -> list[str]:
    """Return what rank 0 warned of; the others are silent."""
    lines = capfd.readouterr().err.splitlines()
    assert comm.rank == 0 or not lines
    mark = "hydrabeam: warning: "
    return comm.bcast([line.removeprefix(mark) for line in lines if line.startswith(mark)])


LATE: dict[str, Any] = {"data.simulate.start": 2469807.5, "sky.positions": "apparent"}


def test_dates_beyond_the_earth_orientation_table_are_told_once(
    workspace: Workspace, on_root: OnRoot, comm: MPI.Comm, capfd: pytest.CaptureFixture[str]
) -> None:
    job = on_root(lambda: workspace.simulation(LATE))
    for command in ("simulate", "infer"):
        assert main([command, str(job), "-o", str(workspace.folder / command)]) == 0
        said, *others = cautions(capfd, comm)
        assert said not in others
        assert "beyond the end" in said
        assert "arcsec" in said
    summary = on_root(lambda: json.loads((workspace.folder / "infer" / "summary.json").read_text()))
    assert said in summary["warnings"]


def test_places_by_sidereal_time_alone_need_no_table(
    workspace: Workspace, on_root: OnRoot, comm: MPI.Comm, capfd: pytest.CaptureFixture[str]
) -> None:
    job = on_root(lambda: workspace.simulation(LATE | {"sky.positions": "lst"}))
    assert main(["simulate", str(job), "-o", str(workspace.folder / "result")]) == 0
    assert cautions(capfd, comm) == []


def flag_held_out(file: h5py.File) -> None:
    flags, jds = file["Data/flags"][()], file["Header/time_array"][()]
    flags[np.isin(jds, np.unique(jds)[1::2])] = True
    file["Data/flags"][...] = flags


def lose_calibration(file: h5py.File) -> None:
    del file["Header/vis_units"]
    file["Header/vis_units"] = np.bytes_("uncalib")


def shift_sidereal_times(file: h5py.File) -> None:
    file["Header/lst_array"][...] = file["Header/lst_array"][()] + 0.01


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (lose_calibration, ["not calibrated", '(vis_units is "uncalib")', "no gains"]),
        (shift_sidereal_times, ["lst_array", "up to 138 s off", "set_lsts_from_time_array()"]),
        (flag_held_out, ["At 131 MHz all held-out data are flagged"]),
    ],
    ids=["uncalibrated", "sidereal times", "held-out data flagged"],
)
def test_doubtful_data_are_told(
    edit: Callable[[h5py.File], None],
    words: list[str],
    workspace: Workspace,
    on_root: OnRoot,
    comm: MPI.Comm,
    capfd: pytest.CaptureFixture[str],
) -> None:
    def prepare() -> Any:
        shutil.copy(workspace.data, workspace.folder / "bad.uvh5")
        with h5py.File(workspace.folder / "bad.uvh5", "r+") as file:
            edit(file)
        return workspace.job({"data.files": ["bad.uvh5"]})

    job = on_root(prepare)
    assert main(["infer", str(job), "-o", str(workspace.folder / "result")]) == 0
    said, *others = cautions(capfd, comm)
    assert said not in others
    assert [word for word in words if word not in said] == []
    assert (
        on_root(lambda: json.loads((workspace.folder / "result" / "summary.json").read_text()))["warnings"][0] == said
    )


def spoil_a_baseline(file: h5py.File) -> None:
    one, two = (file[f"Header/{name}"][()] for name in ("ant_1_array", "ant_2_array"))
    vis = file["Data/visdata"][()]
    own = (one == 1) & (two == 4)
    vis[own] += 100 * np.resize([1, 1j, -1, -1j], own.sum())[:, np.newaxis, np.newaxis]
    file["Data/visdata"][...] = vis


def test_what_stands_out_of_the_data_is_said_once_by_a_loop(
    workspace: Workspace, on_root: OnRoot, comm: MPI.Comm, capfd: pytest.CaptureFixture[str]
) -> None:
    def prepare() -> Any:
        shutil.copy(workspace.data, workspace.folder / "bad.uvh5")
        with h5py.File(workspace.folder / "bad.uvh5", "r+") as file:
            spoil_a_baseline(file)
        return workspace.job({"data.files": ["bad.uvh5"], "loop.effects": ["antenna_positions"]})

    job = on_root(prepare)
    capfd.readouterr()
    assert main(["loop", str(job), "-o", str(workspace.folder / "result")]) == 0
    lines = capfd.readouterr().err.splitlines()
    told = [line.removeprefix("hydrabeam: ").removeprefix("warning: ") for line in lines]
    odd = comm.bcast([line for line in told if line.startswith("A baseline that stands out (baseline 1-4)")])
    assert len(odd) == 1
    summary = on_root(lambda: json.loads((workspace.folder / "result" / "summary.json").read_text()))
    assert odd[0] in summary["warnings"]
