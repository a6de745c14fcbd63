"""A source that the catalogue lacks is told by where it is on the sky, wherever the loop still writes of it.

So is one that varies during the night, or anew in each.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hydrabeam_mpi.cli import main
from hydrabeam_mpi.config import load_job
from tests.loop.mock import mock_job
from tests.loop.test_loop_command import TWO, assert_reproduced, record_of, run_loop

PLACE = (31.37, -28.64)
"""Right ascension and declination, degrees, where no point of the search's grid is."""
NAME = f"source at ra={PLACE[0]:.3f} dec={PLACE[1]:.3f}: "


def test_a_source_is_told_by_its_place(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    source = {"kind": "missing_sources", "settings": {"sources": [list(PLACE)]}, "parameters": {NAME + "flux": 3.0}}
    result = run_loop(mock_job(source, freqs=TWO, loop={"effects": ["missing_sources"]}), tmp_path)
    record = record_of(result)
    assert record["verdict"] == "explained"
    (found,) = record["rounds"]
    assert not found["parameters_not_told"]
    told = {one["name"].rpartition(": ")[2]: one for one in found["parameters"]}
    truth = {"flux": 3.0, "right ascension": PLACE[0], "declination": PLACE[1], "spectral index": -0.7}
    assert told.keys() == truth.keys()
    for what, value in truth.items():
        assert abs(told[what]["value"] - value) < 3 * told[what]["std"]
    assert [told[what]["unit"] for what in truth] == ["Jy", "deg", "deg", ""]
    assert 0 < told["right ascension"]["std"] < 0.1
    assert told["flux"]["sigma"] > 10
    assert told["right ascension"]["sigma"] is None
    ra, dec = (told[what]["value"] for what in ("right ascension", "declination"))
    assert f"source at ra={ra:.3f} dec={dec:.3f}: right ascension {ra:.3f}"[:-1] in found["sentence"]
    _, entry = load_job(result / "amended.toml").effects
    np.testing.assert_allclose(entry.settings["sources"], [[ra, dec]], atol=1e-4)
    assert all("offset" in name for name in entry.names[1:3])
    assert np.all(np.abs(np.array(entry.values)[:, 1:3]) < 1e-4)
    assert main(["infer", str(result / "amended.toml"), "-o", str(tmp_path / "again")]) == 0
    assert_reproduced(result, tmp_path / "again")


LAWS: dict[str, tuple[dict[str, Any], dict[str, float]]] = {
    "smooth": ({"orders": [0, 1]}, {"flux, level": 0.4, "flux, drift from first to last time": 0.2}),
    "nightly": (
        {"orders": [0, 0, 0], "nights": [0, 1, 2]},
        {"flux, night 1: level": 0.2, "flux, night 2: level": 0.5, "flux, night 3: level": 0.3},
    ),
}


@pytest.mark.parametrize("law", [pytest.param(law, marks=[pytest.mark.study] * (law == "nightly")) for law in LAWS])
def test_one_that_varies_is_told_with_its_law(law: str, tmp_path: Path) -> None:
    """From the file that it is put into the data by to the one that has it as it was found."""
    settings, fluxes = LAWS[law]
    source = {
        "kind": "missing_sources",
        "settings": {"law": law, **settings, "sources": [list(PLACE)]},
        "parameters": {NAME + name: flux for name, flux in fluxes.items()},
    }
    # By widths of the evidence, which such a mock of 24 coefficients hardly tells, errors are a sixth too small: z^2 of
    # these parameters is 1.35 in 30 draws of the smooth law, and 1.07 by the stated ones.
    stated = {"widths": "stated"}
    job = mock_job(source, n_times=12, loop={"effects": ["missing_sources"]}, holdout={"every": 2}, prior=stated)
    job["data"]["simulate"] |= {
        "lst_range": ["0.5 h", "3.5 h"],
        "nights": len(settings["orders"]) if law == "nightly" else 1,
    }
    result = run_loop(job, tmp_path)
    record = record_of(result)
    (found,) = record["rounds"]
    assert (found["effect"], found["law"], record["verdict"]) == ("missing_sources", law, "explained")
    told = {one["name"].partition(": ")[2]: one for one in found["parameters"]}
    for name, flux in fluxes.items():
        assert abs(told[name]["value"] - flux) < 3 * told[name]["std"] < 0.03
    assert main(["infer", str(result / "amended.toml"), "-o", str(tmp_path / "again")]) == 0
    assert_reproduced(result, tmp_path / "again")
