"""The beam that comes with the package, against the file that it was fitted to."""

import hashlib

import numpy as np
import pytest
from astropy_healpix import HEALPix
from pyuvdata import UVBeam

from hydrabeam_mpi.tables import embedded_beam

SOURCE = "models/HERA_Vivaldi_power_131MHz_nside64.beamfits"


@pytest.fixture(scope="module")
def source(data_dir):
    path = data_dir / SOURCE
    if not path.exists():
        pytest.skip(f"{path} is missing")
    return path


def test_table_has_all_modes_of_a_real_beam():
    beam = embedded_beam()
    assert beam.basis.n_modes == 7280
    assert beam.info.freq == 131e6
    assert beam.info.pol == "ee"
    coeffs = dict(zip(beam.basis.modes, beam.coeffs, strict=True))
    assert all(coeffs[k, -m] == coeffs[k, m].conjugate() for k, m in beam.basis.modes)


def test_table_names_its_origin(source):
    beam = embedded_beam()
    assert source.name in beam.origin
    assert hashlib.sha256(source.read_bytes()).hexdigest() == beam.sha256


def test_table_reproduces_the_file_with_the_stated_residual(source):
    uvbeam = UVBeam.from_file(str(source))
    lon, lat = HEALPix(64, "ring").healpix_to_lonlat(uvbeam.pixel_array)
    za, az = np.pi / 2 - lat.value, lon.value
    values = uvbeam.data_array[0, list(uvbeam.polarization_array).index(-5), 0].real
    up = za < np.pi / 2 + 1e-9
    beam = embedded_beam()
    assert beam.info.peak == pytest.approx(values[up].max())
    residual = beam(za[up], az[up]) - values[up] / values[up].max()
    assert beam.rms_residual == pytest.approx(np.sqrt(np.mean(residual**2)), rel=1e-6)
    assert beam.max_residual == pytest.approx(np.abs(residual).max(), rel=1e-6)
    assert beam.rms_residual < 1e-5
    assert beam.max_residual < 2.5e-4


def test_feed_lies_east_west():
    """A dipole hardly sees the horizon along its axis."""
    za = np.full(2, np.deg2rad(85))
    east, north = embedded_beam()(za, np.array([0.0, np.pi / 2]))
    assert east < 0.1 * north


def test_beam_is_smooth_and_single_valued_at_the_zenith():
    beam = embedded_beam()
    az = np.linspace(0, 2 * np.pi, 361)
    assert np.ptp(beam(np.zeros(361), az)) < 5e-4
    for za in (0.2, 0.5, 1.0):
        assert np.ptp(beam(np.full(361, np.deg2rad(za)), az)) < 0.01
    profile = beam(np.deg2rad(np.linspace(0, 3, 31)), np.zeros(31))
    assert (np.diff(profile) < 0).all()
    assert profile[0] == pytest.approx(1.011, abs=1e-3)


def test_beam_is_positive_down_to_the_horizon():
    za, az = np.meshgrid(np.deg2rad(np.linspace(20, 90, 141)), np.deg2rad(np.arange(0, 360, 2)))
    values = embedded_beam()(za.ravel(), az.ravel())
    assert values.min() > -1e-5
    assert values.max() < 0.02
