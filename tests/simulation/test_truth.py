"""The true sky and beam of a simulation, as other programs read them."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from astropy import units
from astropy.time import Time
from pyradiosky import SkyModel
from pyuvdata import UVBeam

from hydrabeam_mpi.cli import main
from hydrabeam_mpi.config.simulation import Array, Simulate
from hydrabeam_mpi.io.catalogue import read_catalogue
from hydrabeam_mpi.io.skyh5 import Spectrum, sky_model
from hydrabeam_mpi.model.positions import RotatedPositions
from hydrabeam_mpi.model.sky import mock_sky
from hydrabeam_mpi.simulation.mock import mock_observation

JOB = """
[data.simulate]
array = { hex = [1, 2] }
n_times = 2
freqs = ["120 MHz", "131 MHz"]
noise = false
[sky]
n_sources = 20
[beam]
source = "airy"
diameter = "14 m"
"""


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("truth")
    (folder / "job.toml").write_text(JOB)
    assert main(["simulate", str(folder / "job.toml"), "-o", str(folder / "out")]) == 0
    return folder / "out"


def test_beam_and_sky_are_those_of_the_truth(simulated: Path) -> None:
    beam = UVBeam.from_file(str(simulated / "true_beam.beamfits"))
    sky = read_catalogue(simulated / "sky.skyh5", np.array([120e6, 131e6]), of_date=True)
    with h5py.File(simulated / "truth.h5") as truth:
        np.testing.assert_array_equal(beam.data_array[0, 0], truth["beam"])
        for name in ("ra", "dec"):
            np.testing.assert_allclose(getattr(sky, name), truth[name], rtol=0, atol=1e-15)
        np.testing.assert_allclose(sky.flux, truth["flux"], rtol=1e-14)


def test_other_programs_see_the_sources_where_the_simulation_has_them() -> None:
    """Within what the date's own axes move in a day, and the aberration by the Earth's turning: an arcsecond."""
    observation = mock_observation(Simulate(array=Array(hex=(1, 2)), n_times=2), "ee")
    sky = mock_sky(1, observation.freqs, n_sources=30)
    model = sky_model(sky, Spectrum(observation.freqs, 100e6, -2.7), observation)
    for itime in range(2):
        model.update_positions(Time(observation.times[itime], format="jd"), observation.location)
        altitude, azimuth = model.alt_az
        index, za, az = RotatedPositions(sky, observation).above_horizon(itime)
        np.testing.assert_allclose(np.pi / 2 - altitude[index], za, atol=1 * units.arcsec.to("rad"))
        turned = (np.pi / 2 - azimuth[index] - az + np.pi) % (2 * np.pi) - np.pi
        np.testing.assert_allclose(turned * np.sin(za), 0, atol=1 * units.arcsec.to("rad"))


def test_fluxes_without_a_law_are_those_of_the_channels_and_of_the_reference(tmp_path: Path) -> None:
    freqs = np.array([120e6, 131e6])
    sky = mock_sky(2, freqs, n_sources=10)
    sky_model(sky, Spectrum(freqs, 100e6)).write_skyh5(str(tmp_path / "sky.skyh5"))
    again = read_catalogue(tmp_path / "sky.skyh5", freqs, reference_freq=100e6)
    np.testing.assert_allclose(again.flux, sky.flux, rtol=1e-14)
    np.testing.assert_allclose(again.reference_flux, sky.reference_flux, rtol=1e-14)
    assert SkyModel.from_file(str(tmp_path / "sky.skyh5")).frame == "icrs"
