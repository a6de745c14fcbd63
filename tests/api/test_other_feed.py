"""A result of one polarisation predicts the other one, by the beam turned and by what both feeds share."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hydrabeam_mpi.cli import main
from hydrabeam_mpi.io.beamfits import write_power_beam
from tests.api.nights import SOURCE, predicted
from tests.loop.mock import FREQ, mock_job, write_job
from tests.loop.test_loop_command import GAIN

WIDTHS = (0.3, 0.25)
"""Of the beam of the feed that points East, from East to West and from North to South: direction cosines."""


def write_beams(path: Path) -> None:
    """Write the model beams of both feeds, which are identical and at right angles."""
    za, az = np.meshgrid(np.deg2rad(np.arange(91.0)), np.deg2rad(np.arange(360.0)), indexing="ij")
    east, north = np.sin(za) * np.cos(az), np.sin(za) * np.sin(az)
    ee, nn = (np.exp(-0.5 * ((east / x) ** 2 + (north / y) ** 2)) for x, y in (WIDTHS, WIDTHS[::-1]))
    beams = np.array([[ee], [nn]])
    write_power_beam(path, beams, np.array([FREQ]), ["ee", "nn"], telescope_name="mock", history="made up")


def job_of(pol: str, folder: Path, *injected: dict[str, Any]) -> dict[str, Any]:
    job = mock_job(*injected, basis={"n_modes": 40, "k_max": 16, "m_max": 4})
    job["data"] = {"polarization": pol, **job["data"]}
    return {**job, "beam": {"source": str(folder / "beams.beamfits")}}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Data of both polarisations with a source that the catalogue lacks, a gain that is off in one, and its result."""
    folder = tmp_path_factory.mktemp("feeds")
    write_beams(folder / "beams.beamfits")
    for pol, injected in (("ee", [GAIN, SOURCE]), ("nn", [SOURCE])):
        simulated = write_job(job_of(pol, folder, *injected), folder, f"{pol}_simulated.toml")
        assert main(["simulate", str(simulated), "-o", str(folder / pol)]) == 0
        data = {"files": [str(folder / pol / "data.uvh5")], "polarization": pol}
        loop = {"loop": {"effects": ["antenna_gains", "missing_sources"], "max_rounds": 3}}
        write_job({**job_of(pol, folder), "data": data, **loop}, folder, f"{pol}.toml")
    assert main(["loop", str(folder / "ee.toml"), "-o", str(folder / "result")]) == 0
    return folder


def test_what_both_share_predicts_the_other(folder: Path) -> None:
    told = predicted(folder / "result", folder / "nn.toml", folder / "prediction")
    assert told["assumed"] == "assumed: the beam of nn is that of ee, turned by 90 degrees"
    assert [one["effect"] for one in told["carried_over"]] == ["missing_sources"]
    (left,) = told["not_carried_over"]
    assert (left["effect"], left["reason"]) == ("antenna_gains", "is of the other feed")
    assert told["rms"] < 3 * told["rms_noise"]
    assert told["rms_model_scaled"] > 4 * told["rms"]
    assert told["predictive_chi2"] < 2
