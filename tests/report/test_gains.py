"""Gains that were given, what was found beside them, and a solution that was not applied."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pyuvdata import UVCal, UVData

from hydrabeam_mpi.cli import main
from hydrabeam_mpi.report.gains import compare_gains
from tests.loop.mock import mock_job, write_job
from tests.report.conftest import BULK, drop_arrays
from tests.report.test_document import Page

TRUE = {2: np.exp(0.06 - 0.05j), 4: np.exp(-0.03 + 0.08j)}
GIVEN = {2: TRUE[2], 5: np.exp(0.05 + 0.04j)}
"""Right for antenna 2; that of antenna 4 is overlooked, and that of 5 is wrong."""
PARTS = ("ln amplitude", "phase")
PARAMETERS = {
    f"antenna {antenna} {part}": float(value)
    for antenna, gain in TRUE.items()
    for part, value in zip(PARTS, (np.log(np.abs(gain)), np.angle(gain)), strict=True)
}
JOB = mock_job({"kind": "antenna_gains", "parameters": PARAMETERS})
NAMES = [f"antenna {antenna} {part}" for antenna in range(7) for part in PARTS]
FITTED = {
    "kind": "antenna_gains",
    "names": NAMES,
    "index": list(range(14)),
    "values": [[0.0] * 14],
    "prior_std": [[0.1] * 14],
}


def write_gains(path: Path, data: Path, gains: dict[int, complex], turn: complex = 1.0, **changes: Any) -> Path:
    uvd = UVData.from_file(str(data))
    cal = UVCal.initialize_from_uvdata(uvd, gain_convention="divide", cal_style="redundant", metadata_only=False)
    cal.gain_array[:] = turn
    for antenna, gain in gains.items():
        cal.gain_array[cal.ant_array == antenna] *= gain
    cal.select(**changes)
    cal.write_calfits(str(path))
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Data, files of gains and what was found beside those that were given."""
    folder = tmp_path_factory.mktemp("gains")
    assert main(["simulate", str(write_job(JOB, folder, "mock.toml")), "-o", str(folder / "mock")]) == 0
    data = folder / "mock" / "data.uvh5"
    given = write_gains(folder / "given.calfits", data, GIVEN)
    job = JOB | {"data": {"files": [str(data)], "gains": [str(given)]}, "effects": [FITTED]}
    assert main(["infer", str(write_job(job, folder)), "-o", str(folder / "result")]) == 0
    return folder


def told(folder: Path) -> dict[str, Any]:
    gains: dict[str, Any] = json.loads((folder / "result" / "summary.json").read_text())["gains"]
    return gains


def test_a_result_knows_what_was_given_and_what_was_found(folder: Path) -> None:
    gains, given = told(folder), folder / "given.calfits"
    assert gains["files"] == [{"file": str(given), "sha256": hashlib.sha256(given.read_bytes()).hexdigest()}]
    (channel,) = gains["channels"]
    own = np.exp(np.array(channel["given"]["ln_amplitude"]) + 1j * np.array(channel["given"]["phase"]))
    np.testing.assert_allclose(own, [GIVEN.get(antenna, 1.0) for antenna in gains["antennas"]], rtol=1e-6)


def test_both_together_are_the_truth_but_for_what_no_data_tell(folder: Path) -> None:
    """A solution that is the truth, with another scale and another phase, lies on what was found."""
    data = folder / "mock" / "data.uvh5"
    right = write_gains(folder / "right.calfits", data, TRUE, 1.3 * np.exp(2j))
    (channel,) = compare_gains(told(folder), [right])
    found, other = channel.solutions
    assert found.ln_amplitude_std is not None
    assert found.phase_std is not None
    for name in ("ln_amplitude", "phase"):
        sigma = getattr(found, f"{name}_std")
        assert np.all((sigma > 0) & (sigma < 0.01))
        away = (getattr(found, name) - getattr(other, name)) / sigma
        assert np.sqrt(np.mean(away**2)) < 2
        assert np.ptp(getattr(found, name)) > 0.05
    assert other.removed.ln_amplitude == pytest.approx(np.log(1.3) - 0.08 / 7, abs=1e-6)
    expected = [GIVEN.get(antenna, 1) for antenna in channel.antennas]
    np.testing.assert_allclose(channel.given, expected, rtol=1e-6)


def test_solutions_of_fewer_antennas_are_compared_by_those_alone(folder: Path) -> None:
    data = folder / "mock" / "data.uvh5"
    some = write_gains(folder / "some.calfits", data, TRUE, antenna_nums=[0, 1, 2, 3, 4, 5])
    (channel,) = compare_gains(told(folder), [some])
    found, other = channel.solutions
    assert found.ln_amplitude_std is not None
    away = (found.ln_amplitude - other.ln_amplitude) / found.ln_amplitude_std
    assert np.flatnonzero(np.isnan(away)).tolist() == [6]
    assert np.sqrt(np.nanmean(away**2)) < 2


def test_the_report_has_them_beside_other_solutions(folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    data = folder / "mock" / "data.uvh5"
    other = write_gains(folder / "other.calfits", data, TRUE, antenna_nums=[0, 1, 2, 3, 4, 5])
    drop_arrays(folder / "result", *(name for name in BULK if name != "map_truth"))
    assert main(["report", str(folder / "result"), "--gains", str(other)]) == 0
    page = Page.of(folder / "result")
    assert "The data were divided by g_i g_j* of these files before the fit" in page.text
    assert "other.calfits: rms" in page.text
    heads = [row for row in page.rows if row and row[0] == "antenna" and "other.calfits: amplitude, %" in row]
    assert len(heads) == 1
    (last,) = [row for row in page.rows if row[:1] == ["6"] and len(row) == len(heads[0])]
    assert last[-2:] == ["–", "–"]
    assert (folder / "result" / "figures" / "0_gains.pdf").exists()
    foreign = write_gains(folder / "foreign.calfits", data, {}, antenna_nums=[0, 1])
    uvc = UVCal.from_file(str(foreign))
    uvc.freq_array = uvc.freq_array + 1e6
    uvc.write_calfits(str(foreign), clobber=True)
    capfd.readouterr()
    assert main(["report", str(folder / "result"), "--gains", str(foreign)]) == 2
    assert "foreign.calfits: freq_array: no gains at 131.000000 MHz; give gains" in capfd.readouterr().err


def test_what_is_not_as_it_was_written_is_told(folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = folder / "result" / "summary.json"
    summary = json.loads(path.read_text())
    for gains, words in (({**summary["gains"], "antennas": 3}, "is not as"), (None, "tells of no gains")):
        path.write_text(json.dumps({**summary, "gains": gains}))
        capfd.readouterr()
        other = ["--gains", str(folder / "given.calfits")]
        assert main(["report", str(folder / "result"), *other]) == 2
        assert f"summary.json: {'' if gains else 'gains: '}{words}" in capfd.readouterr().err
    path.write_text(json.dumps(summary))
