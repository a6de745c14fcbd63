"""A beam that was inferred is the same wherever it is asked for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import hydrabeam_mpi as hb
from tests.loop.mock import mock_job, write_job

ZA, AZ = np.array([0, 7, 40, 83]), np.array([0, 30, 200, 359])
"""Degrees, nodes of the grid."""


@pytest.mark.parametrize("pol", ["ee", "en"])
def test_complex_coefficients_give_one_beam(pol: str, tmp_path: Path) -> None:
    """Real where a power beam is, as the maps and the UVBeam are."""
    basis = {"n_modes": 30, "k_max": 10, "m_max": 2, "form": "complex"}
    job = mock_job(basis=basis, noise={"kind": "constant", "sigma": 0.1})
    job["data"] = {"simulate": {**job["data"]["simulate"], "noise": False}, "polarization": pol}
    beam = hb.infer(hb.Setup.from_job(write_job(job, tmp_path))).beam
    values = beam(np.deg2rad(ZA), np.deg2rad(AZ))
    assert np.iscomplexobj(values) == (pol == "en")
    np.testing.assert_allclose(values, beam.maps["mean"][:, ZA, AZ], atol=1e-7)
    uvbeam = beam.to_uvbeam()
    np.testing.assert_allclose(values[0].real, uvbeam.data_array[0, 0, 0, ZA, AZ].real, atol=1e-7)
