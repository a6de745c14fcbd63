"""Gains from files, against pyuvdata's own calibration and measured data."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from astropy.io import fits
from pyuvdata import UVCal
from pyuvdata.utils import uvcalibrate

from hydrabeam_mpi.data.partition import Tile
from hydrabeam_mpi.data.selection import Selection
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io import gain_cover
from hydrabeam_mpi.io.gains import apply_gains, doubt_about_gains, read_gains
from hydrabeam_mpi.io.uvdata import read_observation, read_visibilities
from tests.visibilities import NUMBERS, SECOND, TIMES, expected, make_uvcal, make_uvdata, whole

pytestmark = pytest.mark.filterwarnings("ignore")  # pyuvdata's, on writing and on its own calibration


@pytest.fixture
def read(tmp_path):
    """Function that writes visibilities and gains and reads both, ``read(uv, *cals, extension=...)``."""

    def read(uv, *cals, extension="calfits", selection=None):
        (tmp_path / "a.uvh5").unlink(missing_ok=True)
        uv.write_uvh5(str(tmp_path / "a.uvh5"), run_check=False)
        files = [tmp_path / f"{i}.{extension}" for i in range(len(cals))]
        for cal, path in zip(cals, files, strict=True):
            getattr(cal, f"write_{extension}")(str(path), run_check=False)
        obs = read_observation([tmp_path / "a.uvh5"], selection or Selection())
        return obs, *read_visibilities([tmp_path / "a.uvh5"], obs, whole(obs))[:2], files

    return read


@pytest.mark.parametrize("extension", ["calfits", "calh5"])
@pytest.mark.parametrize("convention", ["divide", "multiply"])
def test_calibration_is_that_of_pyuvdata(read, extension, convention):
    uv = make_uvdata()
    cal = make_uvcal(uv, convention=convention)
    obs, data, flags, files = read(uv, cal, extension=extension)
    calibrated = uvcalibrate(uv, cal, inplace=False)
    found, found_flags, _ = apply_gains(data, flags, obs, whole(obs), files)
    wanted, wanted_flags, _ = expected(calibrated, obs)
    np.testing.assert_array_equal(found_flags, wanted_flags)
    np.testing.assert_allclose(found, wanted, rtol=1e-12, atol=0)
    assert flags.sum() < found_flags.sum() < flags.size


def test_cross_hands_use_both_feeds(read):
    uv = make_uvdata(pols=(-5, -6, -7, -8))
    cal = make_uvcal(uv)
    obs, data, flags, files = read(uv, cal, selection=Selection(pols=("ne", "ee", "en")))
    found, *_ = apply_gains(data, flags, obs, whole(obs), files)
    wanted, _, _ = expected(uvcalibrate(uv, cal, inplace=False), obs)
    np.testing.assert_allclose(found, wanted, rtol=1e-12, atol=0)


def test_corrupted_data_are_recovered(read):
    """V_obs = g_i g_j* V_true by its definition, without any other code."""
    uv = make_uvdata()
    cal = make_uvcal(uv)
    cal.flag_array[:] = False
    true = uv.copy()
    for row in range(uv.Nblts):
        i, j = NUMBERS.index(uv.ant_1_array[row]), NUMBERS.index(uv.ant_2_array[row])
        t = np.argmin(abs(TIMES - uv.time_array[row]))
        uv.data_array[row] *= cal.gain_array[i, :, t] * cal.gain_array[j, :, t].conj()
    obs, data, flags, files = read(uv, cal)
    found, found_flags, _ = apply_gains(data, flags, obs, whole(obs), files)
    wanted, wanted_flags, _ = expected(true, obs)
    np.testing.assert_array_equal(found_flags, wanted_flags)
    np.testing.assert_allclose(found, wanted, rtol=1e-12, atol=0)


def test_tiles_are_parts_of_the_whole(read):
    uv = make_uvdata()
    obs, data, flags, files = read(uv, make_uvcal(uv))
    everything = apply_gains(data, flags, obs, whole(obs), files)
    tile = Tile(np.array([4, 1]), np.array([3, 0]))
    part = np.ix_(range(4), tile.times, tile.bls, range(2))
    for found, full in zip(apply_gains(data[part], flags[part], obs, tile, files), everything, strict=True):
        np.testing.assert_array_equal(found, full[part])


def test_an_idle_rank_has_nothing_to_calibrate(read):
    uv = make_uvdata()
    obs, data, flags, files = read(uv, make_uvcal(uv))
    for tile in (Tile(np.arange(0), np.arange(6)), Tile(np.arange(6), np.arange(0))):
        part = np.ix_(range(4), tile.times, tile.bls, range(2))
        assert apply_gains(data[part], flags[part], obs, tile, files)[0].shape == data[part].shape


def test_a_single_solution_serves_all_times(read):
    uv = make_uvdata()
    cal = make_uvcal(uv, times=TIMES[:1] - 0.3)
    obs, *_, files = read(uv, cal)
    gains, flags = read_gains(files, obs, np.arange(6))
    stored = np.where(cal.flag_array, 1.0, cal.gain_array)
    assert gains.shape == (4, 6, 5, 2)
    np.testing.assert_array_equal(gains, np.broadcast_to(stored.transpose(1, 2, 0, 3), gains.shape))
    np.testing.assert_array_equal(flags, np.broadcast_to(cal.flag_array.transpose(1, 2, 0, 3), gains.shape))


def test_one_file_a_feed_and_one_a_stretch_of_time(read):
    uv = make_uvdata()
    cal = make_uvcal(uv)
    parts = [
        cal.select(times=TIMES[times], jones=[jones], inplace=False)
        for times in ([4, 5], [0, 1, 2, 3])
        for jones in (-6, -5)
    ]
    obs, *_, files = read(uv, *parts)
    gains, flags = read_gains(files, obs, np.arange(6))
    np.testing.assert_array_equal(flags, cal.flag_array.transpose(1, 2, 0, 3))
    np.testing.assert_array_equal(gains, np.where(flags, 1.0, cal.gain_array.transpose(1, 2, 0, 3)))


def test_one_file_a_part_of_the_band_and_an_antenna_that_one_lacks(read, monkeypatch):
    times = TIMES + np.repeat([0.0, 1.0], 3)
    uv = make_uvdata(times=times)
    cal = make_uvcal(uv, times=times)
    parts = [
        cal.select(times=times[night], freq_chans=channels, antenna_nums=numbers, inplace=False)
        for night, channels, numbers in (
            ([0, 1, 2], [0, 1], NUMBERS),
            ([0, 1, 2], [2, 3], NUMBERS),
            ([3, 4, 5], [3, 2], NUMBERS[:3] + NUMBERS[4:]),
            ([3, 4, 5], [0], NUMBERS),
        )
    ]
    obs, data, data_flags, files = read(uv, cal, extension="calh5")
    full, full_flags, full_power = apply_gains(data, data_flags, obs, whole(obs), files)
    files[0].unlink()
    *_, files = read(uv, *parts, extension="calh5")
    gains, flags = read_gains(files, obs, np.arange(6))
    wanted = cal.flag_array.transpose(1, 2, 0, 3).copy()
    wanted[2:, 3:, 3] = wanted[1, 3:] = True
    np.testing.assert_array_equal(flags, wanted)
    np.testing.assert_array_equal(gains, np.where(wanted, 1.0, cal.gain_array.transpose(1, 2, 0, 3)))
    found, found_flags, power = apply_gains(data, data_flags, obs, whole(obs), files)
    lost = np.zeros(data.shape, bool)
    lost[1, 3:] = True
    lost[2:, 3:, (obs.antpairs == 20).any(axis=1)] = True
    np.testing.assert_array_equal(found_flags, full_flags | lost)
    np.testing.assert_array_equal(found, np.where(lost, 0, full))
    np.testing.assert_array_equal(power[~found_flags], full_power[~found_flags])
    told = doubt_about_gains(files, obs)
    assert told is not None
    assert f"lack {100 * (15 + 6) / 120:.2g}% of the gains, of all antennas at some times or channels" in told
    upper = dataclasses.replace(obs, freqs=obs.freqs[2:], channel_width=obs.channel_width[2:])
    monkeypatch.setattr(gain_cover, "AT_ONCE", 30)  # a time
    told = doubt_about_gains(files, upper)
    assert told is not None
    assert "lack 10% of the gains, of antenna 20 at some times or channels" in told
    night = dataclasses.replace(
        upper, times=obs.times[:3], lsts=obs.lsts[:3], integration_time=obs.integration_time[:3]
    )
    assert doubt_about_gains(files, night) is None


def test_what_no_file_of_several_has_is_refused(read):
    uv = make_uvdata()
    cal = make_uvcal(uv)
    one, two = ([3, 7, 11], [0, 1, 3]), ([3, 20, 11], [1, 3, 0])
    parts = [cal.select(antenna_nums=ants, freq_chans=channels, inplace=False) for ants, channels in (one, two)]
    obs, *_, files = read(uv, *parts, extension="calh5")
    with pytest.raises(InputError, match=r"0\.calh5: ant_array: no gains of antenna 41; leave it out"):
        read_gains(files, obs, np.arange(6))
    for path in files:
        path.unlink()
    obs, *_, files = read(uv, *parts, extension="calh5", selection=Selection(exclude_antennas=(41,)))
    with pytest.raises(InputError, match=r"freq_array: no gains at 122\.000000 MHz; give gains with the channels"):
        read_gains(files, obs, np.arange(6))


def test_the_nearest_solution_is_taken(read):
    uv = make_uvdata()
    cal = make_uvcal(uv, times=TIMES[[1, 4]] + 2 * SECOND, integration_time=30.0)
    obs, *_, files = read(uv, cal)
    _, flags = read_gains(files, obs, np.arange(6))
    nearest = cal.flag_array[:, :, [0, 0, 0, 1, 1, 1]]
    np.testing.assert_array_equal(flags, nearest.transpose(1, 2, 0, 3))


def test_solutions_with_a_range_of_times(read):
    uv = make_uvdata()
    edges = TIMES[0] + 30 * SECOND * np.array([[-0.2, 0.8], [0.8, 1.8]])
    cal = make_uvcal(uv, time_array=None, time_range=edges, integration_time=30.0)
    obs, *_, files = read(uv, cal, extension="calh5")
    _, flags = read_gains(files, obs, np.arange(6))
    np.testing.assert_array_equal(flags, cal.flag_array[:, :, [0, 0, 0, 1, 1, 1]].transpose(1, 2, 0, 3))


def test_gains_in_the_average_convention_leave_half(read):
    uv = make_uvdata()
    cal = make_uvcal(uv)
    obs, data, flags, files = read(uv, cal)
    plain, *_ = apply_gains(data, flags, obs, whole(obs), files)
    cal.pol_convention = "avg"
    cal.gain_scale = "Jy"
    obs, data, flags, files = read(uv, cal, extension="calh5")
    half, *_ = apply_gains(data, flags, obs, whole(obs), files)
    np.testing.assert_allclose(half, plain / 2, rtol=1e-14)


@pytest.mark.parametrize(("stated", "factor"), [("sum", 1.0), ("avg", 0.5), (None, 0.5)])
def test_the_convention_that_gains_state_replaces_that_of_the_job(read, tmp_path, stated, factor):
    uv = make_uvdata()
    cal = make_uvcal(uv)
    obs, data, flags, files = read(uv, cal)
    plain, *_ = apply_gains(data, flags, obs, whole(obs), files)
    cal.pol_convention, cal.gain_scale = stated, "Jy" if stated else None
    obs, *_, files = read(uv, cal, extension="calh5")
    job = dataclasses.replace(obs, pol_convention="avg")
    halved, flags, _ = read_visibilities([tmp_path / "a.uvh5"], job, whole(job))
    found, *_ = apply_gains(halved, flags, job, whole(job), files)
    np.testing.assert_allclose(found, factor * plain, rtol=1e-14)


@pytest.mark.parametrize("of_job", [None, "sum", "avg"])
@pytest.mark.parametrize(
    ("of_data", "of_gains"),
    [("avg", "avg"), ("avg", None), ("sum", "sum"), ("sum", None), (None, "avg"), (None, "sum"), (None, None)],
)
def test_statements_of_data_and_gains_are_those_of_pyuvdata(read, tmp_path, of_data, of_gains, of_job):
    """Only what neither states, the job tells; in the end V = 1/2 I B, once."""
    uv = make_uvdata()
    uv.pol_convention = of_data
    cal = make_uvcal(uv)
    cal.pol_convention, cal.gain_scale = of_gains, "Jy"
    obs, *_, files = read(uv, cal, extension="calh5")
    obs = dataclasses.replace(obs, pol_convention=of_job)
    data, flags, _ = read_visibilities([tmp_path / "a.uvh5"], obs, whole(obs))
    found, *_ = apply_gains(data, flags, obs, whole(obs), files)
    calibrated = uvcalibrate(uv, cal, inplace=False)
    wanted, *_ = expected(calibrated, obs)
    factor = 0.5 if (calibrated.pol_convention or of_job) == "avg" else 1.0
    np.testing.assert_allclose(found, factor * wanted, rtol=1e-12, atol=0)


@pytest.mark.parametrize(("of_data", "of_gains"), [("avg", "sum"), ("sum", "avg")])
def test_data_and_gains_of_two_conventions_are_refused(read, of_data, of_gains):
    uv = make_uvdata()
    uv.pol_convention = of_data
    cal = make_uvcal(uv)
    cal.pol_convention, cal.gain_scale = of_gains, "Jy"
    with pytest.raises(ValueError, match="does not match UVCal"):
        uvcalibrate(uv, cal, inplace=False)
    obs, data, flags, files = read(uv, cal, extension="calh5")
    message = f'0.calh5: pol_convention: says "{of_gains}", where visibilities .* say "{of_data}"; correct the one'
    with pytest.raises(InputError, match=message):
        apply_gains(data, flags, obs, whole(obs), files)


def test_files_that_state_no_convention_beside_others_that_do(read, tmp_path):
    """Of both together one gain makes what it should only where they were read in the same way."""
    uv = make_uvdata()
    cal = make_uvcal(uv)
    cal.pol_convention, cal.gain_scale = "avg", "Jy"
    *_, gains = read(uv, cal, extension="calh5")
    paths = [tmp_path / "early.uvh5", tmp_path / "late.uvh5"]
    for path, times, stated in zip(paths, (TIMES[:3], TIMES[3:]), ("avg", None), strict=True):
        part = uv.select(times=times, inplace=False)
        part.pol_convention = stated
        part.write_uvh5(str(path), run_check=False)
    obs = read_observation(paths, Selection())
    with pytest.raises(InputError, match=r'taken otherwise; set \[data\] pol_convention = "avg"'):
        read_gains(gains, obs, np.arange(6))
    obs = dataclasses.replace(obs, pol_convention="avg")
    data, flags, _ = read_visibilities(paths, obs, whole(obs))
    found, *_ = apply_gains(data, flags, obs, whole(obs), gains)
    wanted, *_ = expected(uvcalibrate(uv, cal, inplace=False), obs)
    np.testing.assert_allclose(found, wanted / 2, rtol=1e-12, atol=0)


def test_feeds_are_matched_by_direction(read):
    uv = make_uvdata(x_orientation="north")
    cal = make_uvcal(make_uvdata())
    obs, *_, files = read(uv, cal, selection=Selection(pols=("ee",)))
    _, flags = read_gains(files, obs, np.arange(6))
    np.testing.assert_array_equal(flags[..., 0], cal.flag_array[..., 0].transpose(1, 2, 0))


def test_feeds_without_direction_are_matched_by_name(read):
    uv = make_uvdata(x_orientation=None)
    cal = make_uvcal(make_uvdata(x_orientation="north"))
    obs, *_, files = read(uv, cal, selection=Selection(pols=("yy",)))
    _, flags = read_gains(files, obs, np.arange(6))
    np.testing.assert_array_equal(flags[..., 0], cal.flag_array[..., 1].transpose(1, 2, 0))


def _other_times(cal):
    cal.time_array = cal.time_array + 70 * SECOND
    return 'no gains of feed "e" within an integration of JD'


def _zero(cal):
    cal.gain_array[2, 1, 3, 0], cal.flag_array[2, 1, 3, 0] = 0, False
    return "gain_array: an unflagged gain of antenna 11 is zero, not finite, or beyond reason"


def _nan(cal):
    cal.gain_array[2, 1, 3, 0], cal.flag_array[2, 1, 3, 0] = np.nan, False
    return "gain_array: an unflagged gain of antenna 11 is zero, not finite, or beyond reason"


def _huge(cal):
    cal.gain_array[2, 1, 3, 0], cal.flag_array[2, 1, 3, 0] = 1e200, False
    return r"gain_array: an unflagged gain of antenna 11 is zero, not finite, or beyond reason \(1e\+200"


def _tiny(cal):
    cal.gain_array[2, 1, 3, 0], cal.flag_array[2, 1, 3, 0] = 1e-200, False
    return "gain_array: an unflagged gain of antenna 11 is zero, not finite, or beyond reason"


def _too_small_together(cal):
    cal.gain_array *= 1e-20
    return "gain_array: makes a visibility of .* Jy, which no source and no transmitter has"


def _other_channels(cal):
    cal.freq_array = cal.freq_array + 1e3
    return "freq_array: no gains at 120.000000 MHz"


def _antenna_missing(cal):
    cal.select(antenna_nums=[3, 7, 11, 20])
    return "ant_array: no gains of antenna 41; leave it out with exclude_antennas"


def _feed_missing(cal):
    cal.select(jones=[-5])
    return 'no gains of feed "n"'


@pytest.mark.parametrize(
    "spoil",
    [_other_times, _zero, _nan, _huge, _tiny, _too_small_together, _other_channels, _antenna_missing, _feed_missing],
)
def test_gains_that_do_not_fit_are_refused(read, spoil):
    uv = make_uvdata()
    cal = make_uvcal(uv)
    message = spoil(cal)
    obs, data, flags, files = read(uv, cal)
    with pytest.raises(InputError, match=message):
        apply_gains(data, flags, obs, whole(obs), files)


def test_flagged_gains_may_be_anything(read):
    uv = make_uvdata()
    cal = make_uvcal(uv)
    cal.gain_array[0, 0, 0, 0], cal.flag_array[0, 0, 0, 0] = np.nan, True
    cal.gain_array[1, 0, 0, 0], cal.flag_array[1, 0, 0, 0] = 0, True
    obs, data, flags, files = read(uv, cal)
    found, *_ = apply_gains(data, flags, obs, whole(obs), files)
    assert np.isfinite(found).all()


def test_delays_are_refused(read, tmp_path):
    uv = make_uvdata()
    cal = UVCal.new(
        cal_style="redundant", gain_convention="divide", cal_type="delay", jones_array=np.array([-5, -6]),
        telescope=uv.telescope.copy(), freq_range=np.array([[120e6, 124e6]]), ant_array=np.array(NUMBERS),
        time_array=TIMES, integration_time=10.0, update_telescope_from_known=False, empty=True,
    )  # fmt: skip
    obs, data, flags, _ = read(uv)
    cal.write_calh5(str(tmp_path / "delays.calh5"), run_check=False)
    with pytest.raises(InputError, match="not gains by channel; convert it with"):
        apply_gains(data, flags, obs, whole(obs), [tmp_path / "delays.calh5"])


def test_a_calfits_file_without_the_place_of_its_telescope(read):
    """As older ones are; pyuvdata would look the name up on the network."""
    uv = make_uvdata()
    cal = make_uvcal(uv)
    obs, data, flags, files = read(uv, cal)
    wanted = apply_gains(data, flags, obs, whole(obs), files)
    with fits.open(files[0], mode="update") as hdus:
        for key in ("ARRAYX", "ARRAYY", "ARRAYZ", "LAT", "LON", "ALT", "FRAME"):
            del hdus[0].header[key]
        hdus[0].header["TELESCOP"] = "HERA"
    for found, before in zip(apply_gains(data, flags, obs, whole(obs), files), wanted, strict=True):
        np.testing.assert_array_equal(found, before)


@pytest.mark.parametrize(
    ("content", "message"),
    [(None, r"\[data\] gains: no such file"), (b"", "cannot be read"), (b"SIMPLE  =", "cannot be read")],
)
def test_files_that_are_no_gains_are_refused(read, tmp_path, content, message):
    obs, data, flags, _ = read(make_uvdata())
    path = tmp_path / "bad.calfits"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=message):
        apply_gains(data, flags, obs, whole(obs), [path])
    with pytest.raises(InputError, match="cannot be read as gains"):
        apply_gains(data, flags, obs, whole(obs), [tmp_path / "a.uvh5"])


def test_measured_raw_data_become_the_calibrated_ones(data_dir):
    """An old calfits file, without the telescope's place in it."""
    folder = data_dir / "H1C_2458043-45_LST1.1"
    name = "zen.2458043.40141.xx.HH.XRAA"
    raw, gains, calibrated = (folder / f"{name}{end}" for end in (".uncalibrated.uvh5", ".abs.calfits", ".uvh5"))
    obs = read_observation([raw], Selection())
    data, flags, _ = read_visibilities([raw], obs, whole(obs))
    found, found_flags, _ = apply_gains(data, flags, obs, whole(obs), [gains])
    wanted, wanted_flags, _ = read_visibilities([calibrated], obs, whole(obs))
    good = ~found_flags & ~wanted_flags & (wanted != 0)
    assert good.mean() > 0.6
    # Both files are in single precision.
    assert np.max(np.abs(found[good] / wanted[good] - 1)) < 2e-7
    with pytest.raises(InputError, match="within an integration"):
        read_gains([gains], dataclasses.replace(obs, times=obs.times + 1), np.arange(3))
