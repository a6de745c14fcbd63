"""With few functions of the beam, what they leave of the model beam is no error: `[basis] rest`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import hydrabeam_mpi as hb
from hydrabeam_mpi.cli import main
from hydrabeam_mpi.report.page.result import load_result
from hydrabeam_mpi.report.page.words import introduction
from tests.loop.mock import mock_job, write_job
from tests.loop.test_loop_command import assert_reproduced


def heldout(folder: Path, rest: bool) -> float:
    """Infer with functions that leave a part of the model beam over; the true beam is the model."""
    job = mock_job(basis={"n_modes": 40, "k_max": 12, "m_max": 4, "rest": rest})
    job["beam"] = {"source": "hera-vivaldi-131MHz"}
    job["data"]["simulate"] |= {"nsamples": 1.0, "perturb": {"stretch": [1.0, 1.0], "sidelobe": 0.0}}
    assert main(["infer", str(write_job(job, folder)), "-o", str(folder / "result")]) == 0
    summary = json.loads((folder / "result" / "summary.json").read_text())
    return float(summary["channels"][0]["heldout_chi2_predictive"])


def test_the_rest_of_the_model_beam_is_no_error(tmp_path: Path) -> None:
    without, with_rest = heldout(tmp_path / "without", False), heldout(tmp_path / "with", True)
    assert without > 1e3
    assert with_rest == pytest.approx(1.0, abs=0.3)
    beam = hb.load_posterior(tmp_path / "with" / "result" / "posterior.h5")
    assert beam.mean.shape == (1, 41)
    za, az = (
        one.ravel()
        for one in np.meshgrid(np.deg2rad(np.arange(0, 91, 9)), np.deg2rad(np.arange(0, 360, 40)), indexing="ij")
    )
    np.testing.assert_allclose(beam(za, az)[0], beam.maps["mean"][0, ::9, ::40].ravel(), atol=1e-9)


def test_a_loop_gives_the_beam_the_rest_and_finds_what_is_wrong_beside_it(tmp_path: Path) -> None:
    """What few functions leave of the model beam is no finding, whatever else may seem to explain it.

    `infer` says that they are too few, and what the loop writes has the rest among its functions.
    """
    gain = {"antenna 3 ln amplitude": 0.05, "antenna 3 phase": -0.04}
    job = mock_job({"kind": "antenna_gains", "parameters": gain}, basis={"n_modes": 40, "k_max": 12, "m_max": 4})
    job["beam"] = {"source": "hera-vivaldi-131MHz"}
    job["data"]["simulate"]["perturb"] = {"stretch": [1.0, 1.0], "sidelobe": 0.0}
    job["loop"] = {"effects": ["antenna_gains", "faint_sources", "missing_sources", "basis_truncation"]}
    path, out = write_job(job, tmp_path), tmp_path / "result"
    assert main(["loop", str(path), "-o", str(out)]) == 0
    told = json.loads((out / "loop.json").read_text())
    assert [one["effect"] for one in told["rounds"] if not one["revoked"]] == ["antenna_gains"]
    assert told["verdict"] == "explained"
    found = {one["name"]: one for one in told["rounds"][0]["parameters"]}
    for name, true in gain.items():
        assert abs(found[name]["value"] - true) < 4 * found[name]["std"]
    assert told["prior_widths"][0]["n_beyond"] == 1
    assert hb.load(out).beam.basis.n_modes >= 41
    assert "Fourier-Bessel modes and what the model beam has beyond them" in introduction(load_result(out))
    assert main(["infer", str(out / "amended.toml"), "-o", str(tmp_path / "again")]) == 0
    assert_reproduced(out, tmp_path / "again")
    assert main(["infer", str(path), "-o", str(tmp_path / "without")]) == 0
    warnings = json.loads((tmp_path / "without" / "summary.json").read_text())["warnings"]
    assert any("too small for the model beam itself" in one for one in warnings)
