"""The order in which a result is written: what cannot be converted is not lost."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from pyuvdata import UVBeam

from hydrabeam_mpi.io.posterior_file import ChannelRecord, PosteriorFile
from hydrabeam_mpi.result.output import write_conversions
from hydrabeam_mpi.result.summary import GRID_AZ, GRID_ZA


def content(telescope_name: str = "HERA") -> PosteriorFile:
    record = ChannelRecord(131e6, {}, {"map_mean": np.ones((91, 360))})
    about = {"versions": {"hydrabeam_mpi": "1.0"}}
    return PosteriorFile({}, about, "ee", GRID_ZA, GRID_AZ, [record], telescope_name)


def summary_in(folder: Path) -> Path:
    path = folder / "summary.json"
    path.write_text(json.dumps({"beam_peak": 1.0, "warnings": ["first"]}))
    return path


@pytest.mark.parametrize(
    ("name", "in_header"), [("HERA", "HERA"), ("Mücke d\u0027Été", "Mucke d\u0027Ete"), ("天眼\nFAST", "???FAST")]
)
def test_any_telescope_has_its_beam(name: str, in_header: str, tmp_path: Path) -> None:
    summary = summary_in(tmp_path)
    write_conversions(tmp_path, content(name))
    assert UVBeam.from_file(tmp_path / "beam.beamfits").telescope_name == in_header
    assert json.loads(summary.read_text())["warnings"] == ["first"]


def test_a_conversion_that_fails_is_a_warning(small_disk: Path, capfd: pytest.CaptureFixture[str]) -> None:
    # 262 kB do not go onto 200 kB.
    summary = summary_in(small_disk)
    write_conversions(small_disk, content())
    first, added = json.loads(summary.read_text())["warnings"]
    assert first == "first"
    assert added.startswith("beam.beamfits could not be written (")
    assert added.endswith("; the beam is in posterior.h5, as map_mean.")
    assert [path.name for path in small_disk.iterdir()] == ["summary.json"]
    assert added in capfd.readouterr().err


def test_a_warning_that_finds_no_room_is_said_all_the_same(small_disk: Path, capfd: pytest.CaptureFixture[str]) -> None:
    summary = summary_in(small_disk)
    before = summary.read_bytes()
    (small_disk / "filler").write_bytes(b"x" * shutil.disk_usage(small_disk).free)
    write_conversions(small_disk, content())
    assert summary.read_bytes() == before
    said = capfd.readouterr().err
    assert "beam.beamfits could not be written" in said
    assert "nor could that be added to summary.json (No space left on device)" in said
    assert sorted(os.listdir(small_disk)) == ["filler", "summary.json"]
