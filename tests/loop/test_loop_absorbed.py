"""What the beam can absorb nearly wholly, and what hides behind something else, is found all the same."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from hydrabeam_mpi.cli import main
from tests.loop.mock import mock_job, write_job

BRIGHTEST = [108.50765069441833, -29.137474272686056]  # of the mock sky
FLUX = "source ra=108.508 dec=-29.137: relative flux error"


def loop_over(folder: Path, *injected: dict[str, Any], effects: list[str]) -> dict[str, Any]:
    """Return what the loop says of 19 antennas whose beam has freedom in all directions."""
    job = mock_job(
        *injected,
        n_times=48,
        basis={"n_modes": 216, "k_max": 24, "m_max": 4},
        sky={"n_sources": 300},
        prior={"kind": "fraction", "fraction": 1.0, "floor": 0.05},
        loop={"effects": effects},
    )
    job["data"]["simulate"] |= {"nsamples": 10.0, "array": {"hex": [3, 5]}}
    assert main(["loop", str(write_job(job, folder)), "-o", str(folder / "out")]) == 0
    told: dict[str, Any] = json.loads((folder / "out" / "loop.json").read_text())
    return told


def test_a_flux_that_the_beam_absorbs_by_99_percent(tmp_path: Path) -> None:
    """What is absorbed is marginalised in the evidence: it widens the error, and decides nothing."""
    flux = {"kind": "catalogue_flux", "settings": {"sources": [BRIGHTEST]}, "parameters": {FLUX: 0.08}}
    loop = loop_over(tmp_path, flux, effects=["catalogue_flux", "basis_truncation"])
    assert loop["verdict"] == "explained"
    assert [one["effect"] for one in loop["rounds"]] == ["catalogue_flux"]
    (found,) = loop["rounds"]
    assert found["absorbed_by_beam"] > 0.99
    assert found["log_bayes_factor"] > 1e5
    (parameter,) = found["parameters"]
    assert parameter["name"] == FLUX
    assert parameter["value"] == pytest.approx(0.08, abs=3 * parameter["std"])
    assert loop["error_before"] > 100
    assert loop["error_after"] == pytest.approx(1.0, abs=0.05)


@pytest.mark.study
def test_a_missing_source_beside_couplings(tmp_path: Path) -> None:
    """What was taken for sources that vary, and for more of them, while the couplings were missing, is taken back."""
    source = {
        "kind": "missing_sources",
        "settings": {"sources": [[130.0, -25.0]]},
        "parameters": {"source at ra=130.000 dec=-25.000: flux": 1.0},
    }
    couplings = {"baseline 7-11 real": 0.02, "baseline 7-12 imaginary": -0.03}
    coupling = {
        "kind": "cross_coupling",
        "settings": {"baselines": [[7, 11], [7, 12]]},
        "parameters": couplings,
    }
    loop = loop_over(tmp_path, source, coupling, effects=["missing_sources", "cross_coupling", "basis_truncation"])
    assert loop["verdict"] == "explained"
    assert loop["error_before"] > 1e4
    assert loop["error_after"] == pytest.approx(1.0, abs=0.05)
    standing = {one["effect"]: one for one in loop["rounds"] if not one["revoked"]}
    assert set(standing) == {"missing_sources", "cross_coupling"}
    assert all(one["effect"] == "missing_sources" for one in loop["rounds"] if one["revoked"])
    values = {one["name"]: one for found in standing.values() for one in found["parameters"]}
    for name, value in couplings.items():
        assert values[name]["value"] == pytest.approx(value, abs=3 * values[name]["std"])
    (flux,) = [one for name, one in values.items() if name.endswith("flux")]
    assert flux["value"] == pytest.approx(1.0, abs=3 * flux["std"])
    assert any("missing point sources" in line for one in loop["rounds"] for line in one["revised"])
