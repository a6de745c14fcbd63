"""Data that are means over their integrations: found where the model takes them as of instants, and modelled."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from hydrabeam_mpi.cli import main
from tests.loop.mock import mock_job, write_job


def smeared(folder: Path, seconds: float) -> Path:
    """Seven antennas 40 m apart; noise does not depend on how long the integrations are."""
    simulate = mock_job()["data"]["simulate"] | {"integration_time": seconds, "nsamples": 0.1 / seconds}
    simulate["array"] = {"hex": [2, 3], "spacing": 40.0}
    job = mock_job(data={"simulate": simulate, "smearing": True})
    assert main(["simulate", str(write_job(job, folder)), "-o", str(folder / "data")]) == 0
    return folder / "data" / "data.uvh5"


def loop(data: Path, folder: Path, **settings: Any) -> dict[str, Any]:
    job = mock_job() | {"data": {"files": [str(data)], **settings}}
    assert main(["loop", str(write_job(job, folder)), "-o", str(folder / "result")]) == 0
    return dict(json.loads((folder / "result" / "loop.json").read_text()))


@pytest.mark.study
def test_what_means_lose_is_found(tmp_path: Path) -> None:
    """Fringes turn by half a turn in an integration."""
    seconds = 300.0
    found = loop(smeared(tmp_path, seconds), tmp_path)
    assert [one["effect"] for one in found["rounds"]] == ["smearing"]
    assert found["verdict"] == "explained"
    told = {one["name"]: one for one in found["rounds"][0]["parameters"]}
    length = told["integrations are means over"]
    assert length["unit"] == "s"
    assert abs(length["value"] - seconds) < 4 * length["std"] < 0.1 * seconds


@pytest.mark.study
def test_with_means_in_the_model_nothing_is_wrong(tmp_path: Path) -> None:
    """Sources hardly move through the beam in an integration."""
    data = smeared(tmp_path, 60.0)
    without = loop(data, tmp_path / "without")
    assert [one["effect"] for one in without["rounds"]] == ["smearing"]
    found = loop(data, tmp_path / "with", smearing=True)
    assert found["verdict"] == "consistent"
    assert found["rounds"] == []
