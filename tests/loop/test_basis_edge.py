"""A basis that is zero at its edge, and a beam that is not: no finding, and mended in all that is written."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import h5py
import numpy as np
from pyuvdata import UVBeam

from hydrabeam_mpi import load
from hydrabeam_mpi.cli import main
from hydrabeam_mpi.model.bases.fourier_bessel import FourierBessel
from hydrabeam_mpi.result.summary import evaluate_on_grid
from tests.loop.mock import mock_job, write_job
from tests.loop.test_loop_command import assert_reproduced


def test_a_basis_that_is_zero_at_its_edge_is_no_horizon(tmp_path: Path) -> None:
    """As in the paper, with an element so small that it sees its horizon."""
    job = mock_job(n_times=16, basis={"boundary": "dirichlet", "edge": "92 deg"}, sky={"n_sources": 300})
    job["data"]["simulate"] |= {"nsamples": 100.0, "array": {"hex": [3, 5]}}
    job["beam"]["diameter"] = "3 m"
    job["loop"] = {"effects": ["basis_truncation", "horizon"]}
    out = tmp_path / "result"
    assert main(["loop", str(write_job(job, tmp_path)), "-o", str(out)]) == 0
    told = json.loads((out / "loop.json").read_text())
    assert told["verdict"] == "consistent"
    assert told["rounds"] == told["tried"] == []
    first = told["prior_widths"][0]
    assert first["n_beyond"] > 0
    assert first["predictive_chi2_before"] > 2
    # By itself it would be fitted, and be one that lets through more than all.
    job["loop"] = {"effects": ["horizon"]}
    assert main(["loop", str(write_job(job, tmp_path)), "-o", str(tmp_path / "alone")]) == 0
    alone = json.loads((tmp_path / "alone" / "loop.json").read_text())
    assert (alone["verdict"], alone["rounds"]) == ("unexplained", [])
    assert "a transmission that is not between 0 and 1" in alone["tried"][0]["reason"]
    assert main(["infer", str(out / "amended.toml"), "-o", str(tmp_path / "amended")]) == 0
    summary = json.loads((tmp_path / "amended" / "summary.json").read_text())
    assert summary["ppd_z_std"] < 1 + 5 / np.sqrt(4 * summary["heldout_n"])
    assert_reproduced(out, tmp_path / "amended")
    # What is written is the beam with its further modes, which no beam of the basis comes near at the horizon.
    found = load(out)
    assert found.beam.basis.n_modes == 24 + sum(one["n_beyond"] for one in told["prior_widths"])
    with h5py.File(out / "truth.h5") as file:
        truth = file["beam"][0]
    written, std = found.beam.maps["mean"][0], found.beam.maps["std"][0]
    assert np.median(np.abs(written - truth)[80:] / std[80:]) < 3
    from_samples = found.beam(np.deg2rad(np.full(4, 88.0)), np.deg2rad([0.0, 90.0, 180.0, 270.0]))[0]
    np.testing.assert_allclose(from_samples, written[88, ::90], atol=1e-9)
    uv = UVBeam.from_file(out / "beam.beamfits")
    assert np.abs(uv.data_array[0, 0, 0] / uv.data_array.max() - written / written.max()).max() < 1e-5
    edge = FourierBessel.full(24, 0, boundary="dirichlet", edge=np.deg2rad(92))
    lacking = written - evaluate_on_grid(partial(edge.synthesize, found.beam.mean[0][:24]))
    assert np.abs(lacking / std)[85:].max() > 50
