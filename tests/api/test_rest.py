"""With few functions of the beam, what they leave of the model beam is no error: `[basis] rest`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import hydrabeam_mpi as hb
from hydrabeam_mpi.cli import main
from tests.loop.mock import mock_job, write_job


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
