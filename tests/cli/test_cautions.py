"""What a user should not overlook about the data: one line on the console, and the same words in the summary."""

from __future__ import annotations

import json
from typing import Any

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
        (said,) = cautions(capfd, comm)
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
