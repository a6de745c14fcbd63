"""The visibilities of a tile out of many files."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import h5py
import numpy as np
import pytest

from hydrabeam_mpi.data.partition import Tile
from hydrabeam_mpi.data.selection import Selection
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.uvdata import feeds_of, read_autos, read_observation, read_visibilities
from hydrabeam_mpi.io.uvformat import FORMATS
from tests.visibilities import AUTOS, CROSS, SECOND, TIMES, expected, make_uvdata, whole


@pytest.fixture
def write(tmp_path):
    """Function that writes a uvh5 file without any check of its content."""

    def write(uv, name="a.uvh5"):
        uv.write_uvh5(str(tmp_path / name), run_check=False)
        return tmp_path / name

    return write


def assert_read(files, uv, selection=None):
    """Everything that the files hold is what pyuvdata has in memory."""
    obs = read_observation(files, selection or Selection())
    read = read_visibilities(files, obs, whole(obs))
    channels = np.searchsorted(uv.freq_array, obs.freqs)
    for found, wanted in zip(read, expected(uv, obs), strict=True):
        assert found.shape == (obs.Nfreqs, obs.Ntimes, obs.Nbls, obs.Npols)
        np.testing.assert_array_equal(found, wanted[channels])
    assert [array.dtype for array in read] == [np.complex128, bool, float]


def test_whole_file(write):
    uv = make_uvdata()
    assert_read([write(uv)], uv)


def test_single_precision_file_comes_in_double(write):
    uv = make_uvdata()
    uv.data_array = uv.data_array.astype(np.complex64)
    assert_read([write(uv)], uv)


def test_rows_in_any_order(write):
    uv = make_uvdata()
    # Rows one by one at random; pyuvdata's own orders are all special cases.
    shuffled = uv.copy()
    shuffled.reorder_blts(order=np.random.default_rng(5).permutation(uv.Nblts))
    assert not np.all(np.diff(shuffled.time_array) >= 0)
    assert_read([write(shuffled)], uv)


@pytest.mark.parametrize("order", [("baseline", "time"), ("time", "baseline"), ("ant2", "ant1")])
def test_rows_in_orders_of_pyuvdata(write, order):
    uv = make_uvdata()
    reordered = uv.copy()
    reordered.reorder_blts(order=order[0], minor_order=order[1])
    assert_read([write(reordered)], uv)


def test_channels_and_polarisations_in_any_order(write):
    uv = make_uvdata()
    turned = uv.copy()
    turned.reorder_freqs(channel_order="-freq")
    turned.reorder_pols(order=np.array([1, 0]))
    assert turned.freq_array[0] > turned.freq_array[-1]
    path = write(turned)
    assert_read([path], uv)
    assert_read([path], uv, Selection(pols=("ee", "nn"), channels=(0, 3)))


def test_baselines_missing_at_some_times_are_flagged(write):
    uv = make_uvdata()
    rng = np.random.default_rng(8)
    part = uv.select(blt_inds=np.sort(rng.choice(uv.Nblts, 40, replace=False)), inplace=False)
    path = write(part)
    obs = read_observation([path], Selection())
    assert (obs.Ntimes, obs.Nbls) == (6, 6)
    data, flags, nsamples = read_visibilities([path], obs, whole(obs))
    wanted = expected(uv, obs)
    stored = np.zeros((obs.Ntimes, obs.Nbls), bool)
    for time, ant_1, ant_2 in zip(part.time_array, part.ant_1_array, part.ant_2_array, strict=True):
        here = np.flatnonzero((obs.antpairs == [ant_1, ant_2]).all(axis=1))
        stored[np.argmin(abs(obs.times - time)), here] = True
    assert 0 < stored.mean() < 1
    np.testing.assert_array_equal(data[:, stored], wanted[0][:, stored])
    np.testing.assert_array_equal(flags[:, stored], wanted[1][:, stored])
    assert flags[:, ~stored].all()
    assert not data[:, ~stored].any()
    assert not nsamples[:, ~stored].any()


def _split(uv, how):
    if how == "times":
        return [uv.select(times=TIMES[part], inplace=False) for part in ([0, 1], [4, 5], [2, 3])]
    if how == "channels":
        return [uv.select(freq_chans=part, inplace=False) for part in ([2, 3], [0, 1])]
    if how == "polarisations":
        return [uv.select(polarizations=[pol], inplace=False) for pol in (-6, -5)]
    if how == "baselines":
        return [uv.select(bls=list(part), inplace=False) for part in (CROSS[:2] + AUTOS, CROSS[2:])]
    quarters = [
        half.select(freq_chans=part, inplace=False) for half in _split(uv, "times") for part in ([0, 1, 2], [3])
    ]
    return [quarter.select(polarizations=[pol], inplace=False) for quarter in quarters for pol in (-5, -6)]


@pytest.mark.parametrize(
    "how", ["times", "channels", "polarisations", "baselines", "times, channels and polarisations"]
)
def test_files_that_split_the_data_read_as_one(write, how):
    uv = make_uvdata()
    files = [write(part, f"{i}.uvh5") for i, part in enumerate(_split(uv, how))]
    assert len(files) > 1
    assert_read(files, uv)


def test_tiles_are_parts_of_the_whole(write):
    uv = make_uvdata()
    files = [write(part, f"{i}.uvh5") for i, part in enumerate(_split(uv, "times"))]
    obs = read_observation(files, Selection())
    everything = read_visibilities(files, obs, whole(obs))
    for times, bls in (([5, 1], [2, 0, 4]), ([3], [1]), ([0, 1, 2, 3, 4, 5], [5])):
        tile = Tile(np.array(times), np.array(bls))
        for part, full in zip(read_visibilities(files, obs, tile), everything, strict=True):
            np.testing.assert_array_equal(part, full[:, times][:, :, bls])


def test_an_idle_rank_reads_nothing(tmp_path, write):
    files = [write(make_uvdata())]
    obs = read_observation(files, Selection())
    files[0].unlink()  # nothing left to read, and it is not missed
    empty = Tile(np.arange(0), np.arange(obs.Nbls))
    assert read_visibilities(files, obs, empty)[0].shape == (4, 0, 6, 2)


@pytest.mark.skipif(not Path("/proc/self/io").exists(), reason="only Linux counts the bytes read")
def test_only_the_tile_is_read_from_disk(write):
    uv = make_uvdata(times=2459866.2 + 10 * SECOND * np.arange(60), freqs=120e6 + 1e5 * np.arange(256))
    path = write(uv)
    obs = read_observation([path], Selection(channels=(17,)))
    before = bytes_read()
    read_visibilities([path], obs, Tile(np.arange(20, 22), np.arange(3)))
    tile = bytes_read() - before
    obs = read_observation([path], Selection())
    before = bytes_read()
    read_visibilities([path], obs, whole(obs))
    everything = bytes_read() - before
    assert everything > 0.9 * uv.data_array.nbytes * 6 / 11
    assert tile < 0.1 * everything


def test_memory_follows_the_share_of_a_file_written_in_pieces(tmp_path):
    uv = make_uvdata(times=2459866.2 + 10 * SECOND * np.arange(80), freqs=120e6 + 1e5 * np.arange(512))
    path, file = tmp_path / "pieces.uvh5", uv.copy(metadata_only=True)
    file.initialize_uvh5_file(str(path))
    for rows in np.array_split(np.arange(uv.Nblts), 8):
        arrays = {f"{name}_array": getattr(uv, f"{name}_array")[rows] for name in ("data", "flag", "nsample")}
        file.write_uvh5_part(str(path), **arrays, blt_inds=rows, check_header=False)
    obs = read_observation([path], Selection())
    peaks = []
    for n_times in (80, 10):
        tracemalloc.start()
        read_visibilities([path], obs, Tile(np.arange(n_times), np.arange(obs.Nbls)))
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 0.2 * peaks[0]
    assert_read([path], uv)


def bytes_read() -> int:
    return int(Path("/proc/self/io").read_text().split()[1])


def test_stamps_match_within_rounding(write):
    uv = make_uvdata()
    files = [write(part, f"{i}.uvh5") for i, part in enumerate(_split(uv, "channels"))]
    with h5py.File(files[1], "r+") as file:
        file["Header/time_array"][:] += 4e-10
        file["Header/freq_array"][:] -= 1e-5
    obs = read_observation(files, Selection())
    data, _, _ = read_visibilities(files, obs, whole(obs))
    np.testing.assert_array_equal(data, expected(uv, read_observation([write(uv)], Selection()))[0])


def test_samples_without_weight_are_flagged(write):
    uv = make_uvdata()
    uv.nsample_array[3, 1, 0], uv.nsample_array[4, 2, 1] = 0.0, -1.0
    # Neither of these is used, so neither is an error.
    uv.data_array[3, 1, 0] = np.nan
    uv.flag_array[5, 0, 0], uv.data_array[5, 0, 0], uv.nsample_array[5, 0, 0] = True, np.inf, np.nan
    path = write(uv)
    obs = read_observation([path], Selection())
    data, flags, nsamples = read_visibilities([path], obs, whole(obs))
    for row, channel, pol in ((3, 1, 0), (4, 2, 1), (5, 0, 0)):
        bl = obs.antpairs.tolist().index([uv.ant_1_array[row], uv.ant_2_array[row]])
        assert flags[channel, 0, bl, pol]
        assert data[channel, 0, bl, pol] == 0
    assert np.isfinite(nsamples).all()


@pytest.mark.parametrize("value", [1e31, 1e200j, complex(-1e300, 1e300)])
def test_unflagged_visibilities_beyond_reason_are_refused(tmp_path, value):
    uv = make_uvdata()
    uv.data_array = uv.data_array.astype(np.complex128)
    uv.data_array[4, 2, 1], uv.flag_array[4, 2, 1] = value, False
    path = tmp_path / "a.uvh5"
    uv.write_uvh5(str(path), run_check=False)
    obs = read_observation([path], Selection())
    with pytest.raises(
        InputError, match=r"a.uvh5: data_array: a visibility of 1\.0e\+\d+ Jy, which no source and no tr"
    ):
        read_visibilities([path], obs, whole(obs))
    uv.flag_array[4, 2, 1] = True
    uv.write_uvh5(str(path), run_check=False, clobber=True)
    assert np.abs(read_visibilities([path], obs, whole(obs))[0]).max() < 10


@pytest.mark.parametrize("value", [np.nan, np.inf, complex(0, np.nan)])
def test_unflagged_values_that_are_not_finite_are_refused(write, value):
    uv = make_uvdata()
    uv.data_array[4, 2, 1], uv.flag_array[4, 2, 1] = value, False
    path = write(uv)
    obs = read_observation([path], Selection())
    with pytest.raises(InputError, match=r"a.uvh5: data_array: unflagged NaN or infinite values; flag them"):
        read_visibilities([path], obs, whole(obs))


def test_unflagged_nsamples_that_are_not_finite_are_refused(write):
    uv = make_uvdata()
    uv.nsample_array[4, 2, 1], uv.flag_array[4, 2, 1] = np.nan, False
    path = write(uv)
    obs = read_observation([path], Selection())
    with pytest.raises(InputError, match="nsample_array"):
        read_visibilities([path], obs, whole(obs))


def test_a_sample_in_two_files_is_refused(write):
    uv = make_uvdata()
    files = [write(uv), write(uv.select(times=TIMES[2:3], inplace=False), "b.uvh5")]
    obs = read_observation(files[:1], Selection())
    with pytest.raises(InputError, match=r"b\.uvh5: holds a sample twice, or one that an earlier file holds"):
        read_visibilities(files, obs, whole(obs))


def test_a_sample_twice_in_one_file_is_refused(write):
    uv = make_uvdata()
    path = write(uv)
    with h5py.File(path, "r+") as file:
        # Row 0 and row 1 at the first time become the same baseline.
        file["Header/ant_1_array"][1], file["Header/ant_2_array"][1] = CROSS[0]
    obs = read_observation([path], Selection())
    with pytest.raises(InputError, match="holds a sample twice"):
        read_visibilities([path], obs, whole(obs))


def test_feeds_in_order_of_appearance():
    assert feeds_of(("nn", "ee")) == ("n", "e")
    assert feeds_of(("en",)) == ("e", "n")


def test_autocorrelations(write):
    uv = make_uvdata()
    absent = (uv.ant_1_array == 11) & (uv.ant_2_array == 11) & (uv.time_array == TIMES[4])
    path = write(uv.select(blt_inds=np.flatnonzero(~absent), inplace=False))
    obs = read_observation([path], Selection(pols=("nn", "ee"), channels=(1, 2)))
    autos = read_autos([path], obs, np.array([4, 0])).power
    assert autos.shape == (2, 2, 5, 2)
    assert autos.dtype == float
    for i, time in enumerate((4, 0)):
        for j, ant in enumerate(obs.antenna_numbers):
            for k, pol in enumerate(("nn", "ee")):
                stored = uv.get_data(ant, ant, pol)[time, 1:3]
                flagged = uv.get_flags(ant, ant, pol)[time, 1:3]
                wanted = np.full(2, np.nan) if (time, ant) == (4, 11) else np.where(flagged, 0, stored.real)
                np.testing.assert_array_equal(autos[:, i, j, k], wanted)
    assert np.isnan(autos).sum() == 4
    assert (autos == 0).any()


def test_autocorrelations_in_files_of_their_own(write):
    """With more polarisations than the cross-correlations have."""
    uv = make_uvdata()
    autos = make_uvdata(antpairs=AUTOS, pols=(-5, -6, -7, -8))
    files = [write(autos, "autos.uvh5"), write(uv.select(bls=list(CROSS), inplace=False))]
    assert_read(files, uv)
    obs = read_observation(files, Selection())
    read = read_autos(files, obs, np.arange(6)).power
    stored = np.where(autos.get_flags(20, 20, "ee"), 0, autos.get_data(20, 20, "ee").real).T
    np.testing.assert_array_equal(read[:, :, 3, 0], stored)


def test_cross_hands_take_the_autocorrelations_of_both_feeds(write):
    path = write(make_uvdata(pols=(-5, -6, -7, -8)))
    obs = read_observation([path], Selection(pols=("en",)))
    autos = read_autos([path], obs, np.arange(6)).power
    both = read_autos([path], read_observation([path], Selection(pols=("ee", "nn"))), np.arange(6)).power
    np.testing.assert_array_equal(autos, both)


class TestMeasured:
    """HERA's own files; what is known of them is in their SOURCES.md."""

    def test_two_files_two_polarisations(self, data_dir):
        files = sorted((data_dir / "H1C_2458042_LST5.7").iterdir())
        obs = read_observation(files, Selection())
        assert (obs.Nants, obs.Nbls, obs.Nfreqs, obs.Ntimes, obs.pols) == (8, 28, 64, 120, ("ee", "nn"))
        np.testing.assert_allclose(obs.lsts[[0, -1]] * 12 / np.pi, [5.55, 5.91], atol=0.005)
        data, flags, _ = read_visibilities(files, obs, whole(obs))
        bad = np.isin(obs.antpairs, [0, 11]).any(axis=1)
        assert flags[:, :, bad].all()
        assert not flags[:, :, ~bad].all()
        assert (~bad).sum() == 15
        assert 10 < np.abs(data[~flags]).mean() < 100

    def test_three_nights(self, data_dir):
        files = sorted((data_dir / "H1C_2458043-45_LST1.1").glob("*.XRAA.uvh5"))
        obs = read_observation(files, Selection(pols=("ee",), freqs=(143.75e6,)))
        assert (obs.Nants, obs.Nbls, obs.Nfreqs, obs.Ntimes) == (7, 21, 1, 540)
        assert np.unique(np.floor(obs.times)).tolist() == [2458043, 2458044, 2458045]
        np.testing.assert_allclose([obs.lsts.min() * 12 / np.pi, obs.lsts.max() * 12 / np.pi], [0.77, 1.44], atol=0.005)
        data, flags, _ = read_visibilities(files, obs, whole(obs))
        # The same sky at the same sidereal time on every night, to the gains and the noise.
        night = np.floor(obs.times)
        at_lst = [np.flatnonzero(night == n)[np.argmin(abs(obs.lsts[night == n] - 0.3))] for n in np.unique(night)]
        good = ~flags[0, at_lst].any(axis=(0, 2))
        for later in (1, 2):
            one, other = data[0, at_lst[0]][good].ravel(), data[0, at_lst[later]][good].ravel()
            assert abs(np.vdot(one, other)) > 0.95 * np.linalg.norm(one) * np.linalg.norm(other)

    @pytest.mark.study
    def test_miriad_without_orientation(self, data_dir):
        files = sorted((data_dir / "H1C_lstbin_LST4.95").iterdir())
        observations = [read_observation([path], Selection(pols=("xx",))) for path in files]
        obs = observations[0]
        assert (obs.Nants, obs.Nbls, obs.Nfreqs, obs.Ntimes, obs.pols) == (10, 45, 150, 10, ("xx",))
        even, odd = (
            read_visibilities([path], each, whole(each)) for path, each in zip(files, observations, strict=True)
        )
        good = ~(even[1] | odd[1])
        difference = np.abs(even[0] - odd[0])[good]
        assert 1.0 < np.sqrt(np.mean(difference**2)) / 2 < 1.3
        with pytest.raises(InputError, match='polarization = "xx"'):
            read_observation(files[:1], Selection(pols=("ee",)))


@pytest.mark.parametrize("kind", FORMATS)
@pytest.mark.filterwarnings("ignore")  # pyuvdata's, on what formats and windows do not go with
def test_spectral_windows_are_channels_like_others(tmp_path, kind):
    """The upper band first, and of channels of another width."""
    if kind == "ms":
        pytest.importorskip("casacore", reason="measurement sets need python-casacore")
    narrow = 1e6 if kind == "uvfits" else 5e5
    upper = make_uvdata(freqs=130e6 + 1e6 * np.arange(3), seed=2)
    lower = make_uvdata(freqs=120e6 + narrow * np.arange(3), seed=3)
    for uv, number, width in ((upper, 0, 1e6), (lower, 1, narrow)):
        uv.spw_array[:], uv.flex_spw_id_array[:], uv.channel_width[:] = number, number, width
    uv = upper + lower
    assert uv.Nspws == 2
    assert uv.freq_array[0] > uv.freq_array[-1]
    if kind in ("uvfits", "ms"):
        uv.phase(lon=1.3, lat=-0.6, cat_name="somewhere", phase_frame="icrs")
    path = tmp_path / "file"
    getattr(uv, f"write_{kind}")(str(path))
    obs = read_observation([path], Selection(channels=(0, 1, 3, 5)))
    np.testing.assert_allclose(obs.freqs, [120e6, 120e6 + narrow, 130e6, 132e6], atol=1e-3)
    np.testing.assert_allclose(obs.channel_width, [narrow] * 2 + [1e6] * 2, atol=1e-3)
    data, flags, nsamples = read_visibilities([path], obs, whole(obs))
    uv.unproject_phase()
    for found, wanted in zip((data, flags, nsamples), expected(uv, obs), strict=True):
        np.testing.assert_allclose(found, wanted[[3, 4, 0, 2]], rtol=0, atol=1e-5)
