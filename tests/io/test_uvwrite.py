"""Files written are what pyuvdata and the package read back."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from astropy.coordinates import EarthLocation
from pyuvdata import UVData
from pyuvdata.utils import get_lst_for_time

from hydrabeam_mpi.data.observation import Observation
from hydrabeam_mpi.data.selection import Selection
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.uvdata import feeds_of, read_autos, read_observation, read_visibilities
from hydrabeam_mpi.io.uvwrite import write_uvh5
from tests.visibilities import ENU, LOCATION, whole


def make(pols=("ee", "nn")):
    times = 2459866.2 + np.arange(5) * 10.7 / 86400
    obs = Observation(
        telescope_name="HERA",
        location=LOCATION,
        antenna_numbers=np.array([3, 7, 11, 20, 41]),
        antenna_names=("a", "b", "c", "d", "e"),
        antpos=ENU,
        antpairs=np.array([[3, 7], [20, 11], [3, 41]]),
        freqs=np.array([131e6, 132e6, 140e6]),
        channel_width=np.array([1e5, 1e5, 2e5]),
        times=times,
        lsts=get_lst_for_time(times, telescope_loc=LOCATION),
        integration_time=np.array([10.7, 10.7, 10.7, 10.7, 5.3]),
        pols=pols,
    )
    rng = np.random.default_rng(2)
    shape = (3, 5, 3, len(pols))
    data = rng.normal(size=shape) + 1j * rng.normal(size=shape)
    flags = rng.random(shape) < 0.2
    nsamples = rng.integers(1, 5, size=shape) / 2
    autos = rng.uniform(100, 200, size=(3, 5, 5, len(feeds_of(pols))))
    return obs, data, flags, nsamples, autos


def test_antennas_of_one_name_are_told_apart_by_number(tmp_path):
    obs, data, flags, nsamples, _ = make()
    obs = dataclasses.replace(obs, antenna_names=("nan",) * 5)
    write_uvh5(tmp_path / "data.uvh5", obs, data, flags, nsamples)
    assert list(UVData.from_file(tmp_path / "data.uvh5").telescope.antenna_names) == ["3", "7", "11", "20", "41"]


def test_pyuvdata_reads_back_every_number(tmp_path):
    obs, data, flags, nsamples, autos = make()
    write_uvh5(tmp_path / "data.uvh5", obs, data, flags, nsamples, autos)
    uv = UVData.from_file(tmp_path / "data.uvh5")  # with all of pyuvdata's own checks
    assert uv.vis_units == "Jy"
    assert uv.pol_convention == "sum"
    assert uv.telescope.get_x_orientation_from_feeds() == "east"
    assert uv.get_pols() == ["ee", "nn"]
    assert uv._check_for_cat_type("unprojected").all()
    np.testing.assert_array_equal(uv.freq_array, obs.freqs)
    np.testing.assert_array_equal(uv.channel_width, obs.channel_width)
    np.testing.assert_array_equal(np.unique(uv.time_array), obs.times)
    np.testing.assert_array_equal(np.unique(uv.lst_array), obs.lsts)
    np.testing.assert_array_equal(uv.integration_time.reshape(5, -1)[:, 0], obs.integration_time)
    np.testing.assert_allclose(uv.telescope.get_enu_antpos(), ENU, rtol=0, atol=1e-8)
    for b, (ant_1, ant_2) in enumerate(obs.antpairs.tolist()):
        for p, pol in enumerate(obs.pols):
            np.testing.assert_array_equal(uv.get_data(ant_1, ant_2, pol), data[:, :, b, p].T)
            np.testing.assert_array_equal(uv.get_flags(ant_1, ant_2, pol), flags[:, :, b, p].T)
            np.testing.assert_array_equal(uv.get_nsamples(ant_1, ant_2, pol), nsamples[:, :, b, p].T)
    for a, ant in enumerate(obs.antenna_numbers):
        for p, pol in enumerate(obs.pols):
            np.testing.assert_array_equal(uv.get_data(ant, ant, pol), autos[:, :, a, p].T)
            assert not uv.get_flags(ant, ant, pol).any()


@pytest.mark.parametrize("pols", [("ee",), ("nn", "ee"), ("xx", "yy"), ("ee", "en", "ne", "nn")])
def test_package_reads_back_every_number(tmp_path, pols):
    obs, data, flags, nsamples, autos = make(pols)
    path = tmp_path / "data.uvh5"
    write_uvh5(path, obs, data, flags, nsamples, autos)
    back = read_observation([path], Selection(pols=pols))
    order = [back.antpairs.tolist().index(pair) for pair in obs.antpairs.tolist()]
    for field in ("antenna_numbers", "freqs", "channel_width", "times", "lsts", "integration_time"):
        used = np.isin(obs.antenna_numbers, obs.antpairs) if field == "antenna_numbers" else slice(None)
        np.testing.assert_array_equal(getattr(back, field), getattr(obs, field)[used])
    assert back.pols == obs.pols
    np.testing.assert_allclose(back.antpos, obs.antpos, rtol=0, atol=1e-12)
    read = read_visibilities([path], back, whole(back))
    for found, wanted in zip(read, (np.where(flags, 0, data), flags, nsamples), strict=True):
        np.testing.assert_array_equal(found[:, :, order], wanted)
    np.testing.assert_array_equal(read_autos([path], back, np.arange(5)).power, autos)


def test_autocorrelations_that_are_not_known_are_flagged(tmp_path):
    obs, data, flags, nsamples, autos = make(("ee",))
    autos[1, 2, 3] = np.nan
    path = tmp_path / "data.uvh5"
    write_uvh5(path, obs, data, flags, nsamples, autos)
    back = read_autos([path], read_observation([path], Selection()), np.arange(5)).power
    np.testing.assert_array_equal(back, np.nan_to_num(autos))


def test_without_autocorrelations(tmp_path):
    obs, data, flags, nsamples, _ = make()
    write_uvh5(tmp_path / "data.uvh5", obs, data, flags, nsamples)
    uv = UVData.from_file(tmp_path / "data.uvh5")
    assert uv.Nblts == 15
    back = read_observation([tmp_path / "data.uvh5"], Selection())
    assert np.isnan(read_autos([tmp_path / "data.uvh5"], back, np.arange(5)).power).all()


def test_other_places_and_mock_sidereal_times(tmp_path):
    """A mock's LST need not be that of its JD."""
    obs, data, flags, nsamples, _ = make()
    obs = dataclasses.replace(
        obs,
        location=EarthLocation.from_geodetic(-118.3, 37.2, 1222.0),
        lsts=np.linspace(6.1, 6.5, 5) % (2 * np.pi),
    )
    path = tmp_path / "data.uvh5"
    write_uvh5(path, obs, data, flags, nsamples)
    back = read_observation([path], Selection())
    np.testing.assert_array_equal(back.lsts, obs.lsts)
    np.testing.assert_allclose(back.antpos, obs.antpos, rtol=0, atol=1e-12)
    assert abs(back.location.z - obs.location.z).to_value("m") < 1e-8


def test_an_existing_file_is_replaced_whole(tmp_path):
    obs, data, flags, nsamples, _ = make()
    path = tmp_path / "data.uvh5"
    path.write_text("old")
    write_uvh5(path, obs, data, flags, nsamples)
    assert read_observation([path], Selection()).Nbls == 3
    assert [entry.name for entry in tmp_path.iterdir()] == ["data.uvh5"]


def test_a_failure_leaves_what_was_there(tmp_path):
    obs, data, flags, nsamples, _ = make()
    path = tmp_path / "data.uvh5"
    path.write_text("old")
    with pytest.raises(ValueError, match="shape"):
        write_uvh5(path, obs, data, flags[:1], nsamples)
    assert path.read_text() == "old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["data.uvh5"]


def test_unwritable_place_is_one_line(tmp_path):
    obs, data, flags, nsamples, _ = make()
    with pytest.raises(InputError, match="cannot be written"):
        write_uvh5(tmp_path / "nowhere" / "data.uvh5", obs, data, flags, nsamples)
