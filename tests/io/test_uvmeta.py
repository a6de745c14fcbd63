"""The metadata of many files as one observation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydrabeam_mpi.data.selection import Selection
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.uvdata import read_observation
from hydrabeam_mpi.io.uvsurvey import pair_keys
from hydrabeam_mpi.model.engines.smearing import smearing_of
from tests.visibilities import CROSS, ENU, LOCATION, NUMBERS, SECOND, make_uvdata


@pytest.fixture
def write(tmp_path):
    """Function that writes a uvh5 file without any check of its content."""

    def write(uv, name="a.uvh5"):
        (tmp_path / name).unlink(missing_ok=True)
        uv.write_uvh5(str(tmp_path / name), run_check=False)
        return tmp_path / name

    return write


def test_observation_says_what_the_file_says(write):
    uv = make_uvdata()
    obs = read_observation([write(uv)], Selection())
    assert obs.telescope_name == "made"
    assert abs(obs.location.x - LOCATION.x).to_value("m") < 1e-8
    assert abs(obs.location.z - LOCATION.z).to_value("m") < 1e-8
    assert obs.antenna_numbers.tolist() == list(NUMBERS)
    assert obs.antenna_names == ("A3", "A7", "A11", "A20", "A41")
    assert obs.pols == ("ee", "nn")
    assert sorted(map(tuple, obs.antpairs.tolist())) == sorted(CROSS)
    np.testing.assert_allclose(obs.antpos, ENU, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(obs.freqs, uv.freq_array)
    np.testing.assert_array_equal(obs.channel_width, np.full(4, 1e6))
    np.testing.assert_array_equal(obs.times, np.unique(uv.time_array))
    np.testing.assert_array_equal(obs.lsts, np.unique(uv.lst_array))
    np.testing.assert_array_equal(obs.integration_time, np.full(6, 10.0))


def test_baselines_keep_their_orientation(write):
    """pos(ant2) - pos(ant1) of the pair as stored, which is pyuvdata's uvw of a drift scan."""
    uv = make_uvdata()
    obs = read_observation([write(uv)], Selection())
    assert [20, 11] in obs.antpairs.tolist()
    for (ant_1, ant_2), vector in zip(obs.antpairs.tolist(), obs.bl_vectors, strict=True):
        stored = uv.uvw_array[(uv.ant_1_array == ant_1) & (uv.ant_2_array == ant_2)]
        np.testing.assert_allclose(stored, np.tile(vector, (6, 1)), rtol=0, atol=1e-8)


def test_antennas_are_those_of_the_selected_baselines(write):
    obs = read_observation([write(make_uvdata())], Selection(exclude_antennas=(7,)))
    assert obs.antenna_numbers.tolist() == [3, 11, 20, 41]
    assert obs.antenna_names == ("A3", "A11", "A20", "A41")
    np.testing.assert_allclose(obs.antpos, ENU[[0, 2, 3, 4]], rtol=0, atol=1e-12)


def test_selection_reaches_every_axis(write):
    uv = make_uvdata()
    times = np.unique(uv.time_array)
    selection = Selection(pols=("nn",), antpairs=((7, 3), (20, 11)), channels=(2,), time_range=(times[1], times[3]))
    obs = read_observation([write(uv)], selection)
    assert obs.pols == ("nn",)
    assert obs.antpairs.tolist() == [[3, 7], [20, 11]]
    assert obs.freqs.tolist() == [122e6]
    assert obs.times.tolist() == times[1:4].tolist()


@pytest.mark.parametrize(
    ("orientation", "asked", "got"),
    [
        ("east", ("nn", "ee"), ("nn", "ee")),
        ("east", ("xx",), ("ee",)),
        ("north", ("ee",), ("ee",)),
        ("north", ("xx",), ("nn",)),
        (None, ("yy",), ("yy",)),
        (None, None, ("xx", "yy")),
    ],
)
def test_polarisations_by_either_name(write, orientation, asked, got):
    path = write(make_uvdata(x_orientation=orientation))
    assert read_observation([path], Selection(pols=asked)).pols == got


def test_unknown_orientation_names_the_remedy(write):
    path = write(make_uvdata(x_orientation=None))
    with pytest.raises(InputError, match='does not tell where its feeds point; ask for polarization = "xx" or "yy"'):
        read_observation([path], Selection(pols=("ee",)))


def test_polarisation_not_in_the_file(write):
    with pytest.raises(InputError, match='no polarisation "en"; ask for polarization = "ee" or "nn"'):
        read_observation([write(make_uvdata())], Selection(pols=("en",)))


def test_stokes_data_are_told_what_is_needed(write):
    """And not to ask for a polarisation that a job cannot name."""
    path = write(make_uvdata(pols=(1, 2), x_orientation=None))
    with pytest.raises(
        InputError, match=r"only the polarisations pI, pQ, .*; give the data of which these are sums"
    ) as caught:
        read_observation([path], Selection(pols=("ee",)))
    assert "ask for" not in str(caught.value)


def test_two_channels_at_one_frequency_are_refused(write):
    uv = make_uvdata()
    uv.freq_array[2] = uv.freq_array[0] + 0.5
    with pytest.raises(InputError, match=r"freq_array: two channels at 120\.00000\d MHz; keep one"):
        read_observation([write(uv)], Selection())


def test_antennas_to_leave_out_must_be_of_the_array(write):
    uv = make_uvdata(antpairs=((3, 7), (3, 11)))
    path = write(uv)
    assert read_observation([path], Selection(exclude_antennas=(11, 41))).antpairs.tolist() == [[3, 7]]
    with pytest.raises(InputError, match=r"\[data\] exclude_antennas: antenna 99 is not in the data"):
        read_observation([path], Selection(exclude_antennas=(11, 99)))


@pytest.mark.parametrize(("units", "uncalibrated"), [("Jy", False), ("uncalib", True)])
def test_uncalibrated_data_are_known_as_such(write, units, uncalibrated):
    uv = make_uvdata()
    uv.vis_units = units
    assert read_observation([write(uv)], Selection()).uncalibrated is uncalibrated


def test_nights_are_put_in_order_of_time(write):
    times = 2459866.2 + 10 * SECOND * np.arange(3)
    nights = [write(make_uvdata(times=times + day), f"{day}.uvh5") for day in (1, 0, 2)]
    obs = read_observation(nights, Selection())
    np.testing.assert_array_equal(obs.times, np.concatenate([times, times + 1, times + 2]))
    sidereal = np.diff(np.unwrap(obs.lsts[::3])) % (2 * np.pi)
    np.testing.assert_allclose(sidereal, 2 * np.pi * 0.00273791, rtol=1e-3)


def test_stamps_that_differ_by_rounding_are_one(write):
    uv = make_uvdata()
    other = make_uvdata(freqs=125e6 + 1e6 * np.arange(2))
    other.time_array = other.time_array + 3e-10
    obs = read_observation([write(uv), write(other, "b.uvh5")], Selection())
    assert obs.Ntimes == 6
    assert obs.Nfreqs == 6
    # Rows of one file may differ too.
    uv.time_array[::3] -= 1e-9
    uv.freq_array[1] += 1e-3
    assert read_observation([write(uv)], Selection()).Ntimes == 6


def test_files_that_leave_gaps_are_refused(write):
    times = 2459866.2 + 10 * SECOND * np.arange(6)
    early = write(make_uvdata(times=times[:3]))
    late = write(make_uvdata(times=times[3:], freqs=120e6 + 1e6 * np.arange(3)), "b.uvh5")
    with pytest.raises(InputError, match=r'no file holds "ee" at 123\.000000 MHz'):
        read_observation([early, late], Selection())
    assert read_observation([early, late], Selection(channels=(0, 1, 2))).Nfreqs == 3
    one_pol = write(make_uvdata(times=times[3:], pols=(-6,)), "c.uvh5")
    with pytest.raises(InputError, match='no file holds "ee"'):
        read_observation([early, one_pol], Selection())
    assert read_observation([early, one_pol], Selection(pols=("nn",))).pols == ("nn",)


def test_other_arrays_are_refused(write):
    one = write(make_uvdata())
    shifted = make_uvdata(times=2459867.2 + 10 * SECOND * np.arange(2), enu=ENU + 0.01 * np.eye(5, 3))
    with pytest.raises(InputError, match=r"antenna 3 stands 0\.01 m away"):
        read_observation([one, write(shifted, "b.uvh5")], Selection())


def test_other_telescopes_are_refused(write):
    far = make_uvdata(times=2459867.2 + 10 * SECOND * np.arange(2))
    far.telescope.location = type(LOCATION).from_geodetic(LOCATION.lon, LOCATION.lat, LOCATION.height * 2)
    with pytest.raises(InputError, match=r"a telescope 1\.05e\+03 m away from that of a\.uvh5"):
        read_observation([write(make_uvdata()), write(far, "b.uvh5")], Selection())


def test_no_file_and_the_same_file_twice_are_refused(write, tmp_path):
    with pytest.raises(InputError, match="no files"):
        read_observation([], Selection())
    path = write(make_uvdata())
    (tmp_path / "link.uvh5").symlink_to(path)
    with pytest.raises(InputError, match="named twice"):
        read_observation([path, tmp_path / "link.uvh5"], Selection())


def test_baseline_dependent_averaging_is_refused(write):
    uv = make_uvdata()
    uv.integration_time = np.where((uv.ant_1_array == 3) & (uv.ant_2_array == 41), 10.0, 20.0)
    with pytest.raises(InputError, match="integrations of 10 to 20 s, depending on the baseline"):
        read_observation([write(uv)], Selection())
    uv.integration_time = np.where(uv.time_array < np.median(uv.time_array), 10.0, 20.0)
    assert read_observation([write(uv)], Selection()).integration_time.tolist() == [10.0] * 3 + [20.0] * 3


def test_averaging_of_short_baselines_alone_is_refused(write):
    """Of an even number of integrations: no time stamp is that of both."""
    uv, mean = make_uvdata(), make_uvdata()
    uv.select(bls=[(3, 41), (7, 41), (7, 20)])
    mean.select(bls=[(3, 7), (20, 11), (3, 11)])
    mean.downsample_in_time(n_times_to_avg=2)
    with pytest.raises(InputError, match="integrations of 10 to 20 s, depending on the baseline"):
        read_observation([write(uv + mean)], Selection())


def test_an_antenna_that_joins_where_integrations_get_shorter(write):
    times = 2459866.2 + SECOND * np.array([5.0, 15.0, 22.5])
    uv = make_uvdata(times=times)
    uv.integration_time = np.where(uv.time_array > times[1] + SECOND, 5.0, 10.0)
    late = (uv.ant_1_array == 41) | (uv.ant_2_array == 41)
    uv.select(blt_inds=np.flatnonzero(~late | (uv.time_array > times[0] + SECOND)))
    obs = read_observation([write(uv)], Selection())
    assert obs.integration_time.tolist() == [10.0, 10.0, 5.0]
    assert 41 in obs.antenna_numbers


def test_antenna_without_position_is_refused_if_used(write):
    uv = make_uvdata()
    uv.telescope.antenna_positions[1] = np.nan
    path = write(uv)
    with pytest.raises(InputError, match=r"antenna 7 has no position.*exclude_antennas"):
        read_observation([path], Selection())
    assert 7 not in read_observation([path], Selection(exclude_antennas=(7,))).antenna_numbers


def test_antenna_missing_from_the_table_is_refused(write):
    uv = make_uvdata()
    uv.telescope.antenna_numbers = np.array([3, 7, 11, 20, 42])
    with pytest.raises(InputError, match="antenna 41 has no position"):
        read_observation([write(uv)], Selection())


def test_antennas_in_one_place_are_refused(write):
    uv = make_uvdata()
    uv.telescope.antenna_positions[2] = uv.telescope.antenna_positions[0]
    with pytest.raises(InputError, match="antennas 3 and 11 share one position"):
        read_observation([write(uv)], Selection())


def test_both_orientations_of_a_baseline_are_refused(write):
    one = write(make_uvdata(antpairs=((3, 7), (7, 11))))
    other = write(make_uvdata(antpairs=((7, 3), (7, 11)), times=np.array([2459867.2])), "b.uvh5")
    with pytest.raises(InputError, match=r"baseline \(3, 7\) is stored in both orientations.*conjugate_bls"):
        read_observation([one, other], Selection())


def test_autocorrelations_alone_are_refused(write):
    with pytest.raises(InputError, match="no cross-correlations"):
        read_observation([write(make_uvdata(antpairs=((3, 3), (7, 7))))], Selection())


def test_pair_keys_order_like_pairs():
    pairs = np.array([[2, 1], [0, 5000], [0, 3], [70000, 2]])
    np.testing.assert_array_equal(np.argsort(pair_keys(pairs)), [2, 1, 0, 3])


def test_an_observation_knows_whether_its_files_were_phased(write):
    """What means over an integration lose depends on it."""
    uv = make_uvdata()
    assert not read_observation([write(uv)], Selection()).is_phased
    uv.phase(lon=1.3, lat=-0.6, cat_name="somewhere", phase_frame="icrs")
    observation = read_observation([write(uv)], Selection())
    assert observation.is_phased
    with pytest.raises(InputError, match=r"\[data\] smearing: is of means of a drift scan, and the files are phased"):
        smearing_of(replace(observation, is_smeared=True))
    uv.phase(lon=0, lat=np.pi / 2, cat_name="zenith", cat_type="driftscan", phase_frame="altaz")
    assert not read_observation([write(uv)], Selection()).is_phased
