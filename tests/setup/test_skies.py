"""The sky of a job."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from astropy import units
from astropy.coordinates import SkyCoord
from pyradiosky import SkyModel

from hydrabeam_mpi.config import Job, load_job
from hydrabeam_mpi.config.simulation import Array, Simulate
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.setup.skies import load_sky
from hydrabeam_mpi.simulation.mock import mock_observation

OBSERVATION = replace(
    mock_observation(Simulate(array=Array(hex=(1, 2)), n_times=2), "ee"),
    freqs=np.array([150e6]),
    channel_width=np.array([1e5]),
)


def test_a_cut_needs_no_reference_frequency_of_a_catalogue_of_some_channels(tmp_path: Path) -> None:
    """That of mocks, 100 MHz, nobody asked for."""
    SkyModel(
        name=["a", "b"],
        skycoord=SkyCoord([10.0, 50.0], [-30.0, -37.0], unit="deg"),
        stokes=np.array([[[2.0, 0.5], [4.0, 4.5]]] + [np.zeros((2, 2))] * 3) * units.Jy,
        spectral_type="full",
        freq_array=np.array([140e6, 160e6]) * units.Hz,
    ).write_skyh5(str(tmp_path / "sky.skyh5"))
    catalogue = {"kind": "catalogue", "file": str(tmp_path / "sky.skyh5"), "flux_min": 1.0}
    sky = load_sky(job(tmp_path, catalogue), OBSERVATION)
    assert (sky.names, sky.reference_freq) == (("a",), 140e6)
    assert load_sky(job(tmp_path, catalogue | {"reference_freq": 160e6}), OBSERVATION).names == ("a", "b")
    with pytest.raises(InputError, match="only from 140 to 160 MHz; choose one of these, or leave it out"):
        load_sky(job(tmp_path, catalogue | {"reference_freq": 100e6}), OBSERVATION)


def test_fluxes_of_a_mock_are_at_100_mhz(tmp_path: Path) -> None:
    sky = load_sky(job(tmp_path, {"n_sources": 100, "flux_range": [0.1, 100.0]}), OBSERVATION)
    assert sky.reference_freq == 100e6
    np.testing.assert_allclose(sky.flux[0], sky.reference_flux * 1.5**-2.7)


def job(folder: Path, sky: dict[str, object]) -> Job:
    table = {"data": {"simulate": {"array": {"hex": [1, 2]}}}, "sky": sky, "beam": {"source": "airy", "diameter": 14.0}}
    (folder / "job.toml").write_text(tomli_w.dumps(table))
    return load_job(folder / "job.toml")
