"""A basis that is zero at its edge, and a beam that is not: no horizon, and mended by the amended job."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from hydrabeam_mpi.cli import main
from tests.loop.mock import mock_job, write_job


def test_a_basis_that_is_zero_at_its_edge_is_no_horizon(tmp_path: Path) -> None:
    """As in the paper, with an element so small that it sees its horizon."""
    job = mock_job(n_times=16, basis={"boundary": "dirichlet", "edge": "92 deg"}, sky={"n_sources": 300})
    job["data"]["simulate"] |= {"nsamples": 100.0, "array": {"hex": [3, 5]}}
    job["beam"]["diameter"] = "3 m"
    job["loop"] = {"effects": ["basis_truncation", "horizon"]}
    out = tmp_path / "result"
    assert main(["loop", str(write_job(job, tmp_path)), "-o", str(out)]) == 0
    told = json.loads((out / "loop.json").read_text())
    assert told["verdict"] == "explained"
    assert [one["effect"] for one in told["rounds"]] == ["basis_truncation"]
    assert told["error_before"] > 2
    (refused,) = told["tried"]
    assert refused["effect"] == "horizon"
    assert "sources behind it would be brighter" in refused["reason"]
    assert main(["infer", str(out / "amended.toml"), "-o", str(tmp_path / "amended")]) == 0
    summary = json.loads((tmp_path / "amended" / "summary.json").read_text())
    assert summary["ppd_z_std"] < 1 + 5 / np.sqrt(4 * summary["heldout_n"])
