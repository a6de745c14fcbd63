"""The noise, from whatever tells it."""

from __future__ import annotations

import dataclasses

import h5py
import numpy as np
import pytest

from hydrabeam_mpi.data.partition import Tile
from hydrabeam_mpi.data.selection import Selection
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.noise import (
    check_weights,
    constant_weights,
    difference_variance,
    file_weights,
    radiometer_weights,
    variance_weights,
)
from hydrabeam_mpi.io.uvdata import read_observation, read_visibilities
from tests.io.test_gains import make_uvcal
from tests.visibilities import AUTOS, CROSS, NUMBERS, SECOND, make_uvdata, whole

T0 = 2459866.2


@pytest.fixture
def read(tmp_path):
    """Function that writes visibilities and reads them, ``obs, flags, nsamples, [path] = read(uv)``."""

    def read(uv, selection=None, name="a.uvh5"):
        (tmp_path / name).unlink(missing_ok=True)
        uv.write_uvh5(str(tmp_path / name), run_check=False)
        files = [tmp_path / name]
        obs = read_observation(files, selection or Selection())
        _, flags, nsamples = read_visibilities(files, obs, whole(obs))
        return obs, flags, nsamples, files

    return read


class TestRadiometer:
    def test_is_the_radiometer_equation(self, read):
        uv = make_uvdata(pols=(-5, -6, -7, -8))
        obs, flags, nsamples, files = read(uv, Selection(pols=("ee", "nn", "en", "ne")))
        weights = radiometer_weights(files, obs, whole(obs), flags, nsamples)
        some = 0
        for b, (j, k) in enumerate(obs.antpairs.tolist()):
            for p, pol in enumerate(obs.pols):
                v_j, v_k = uv.get_data(j, j, 2 * pol[0]).real.T, uv.get_data(k, k, 2 * pol[1]).real.T
                bad = uv.get_flags(j, j, 2 * pol[0]).T | uv.get_flags(k, k, 2 * pol[1]).T | flags[..., b, p]
                variance = v_j * v_k / (1e6 * 10.0 * nsamples[..., b, p])
                wanted = np.where(bad, 0, 1 / variance)
                np.testing.assert_allclose(weights[..., b, p], wanted, rtol=1e-13)
                some += (wanted > 0).sum()
        assert 0 < some < weights.size

    def test_of_a_tile_is_part_of_the_whole(self, read):
        obs, flags, nsamples, files = read(make_uvdata())
        everything = radiometer_weights(files, obs, whole(obs), flags, nsamples)
        tile = Tile(np.array([5, 2]), np.array([1, 4, 0]))
        part = np.ix_(range(4), tile.times, tile.bls, range(2))
        found = radiometer_weights(files, obs, tile, flags[part], nsamples[part])
        np.testing.assert_array_equal(found, everything[part])

    def test_takes_the_channel_width_of_the_observation(self, read):
        obs, flags, nsamples, files = read(make_uvdata())
        narrow = dataclasses.replace(obs, channel_width=obs.channel_width / 16)
        wide, thin = (radiometer_weights(files, o, whole(o), flags, nsamples) for o in (obs, narrow))
        np.testing.assert_allclose(thin, wide / 16, rtol=1e-14)

    def test_is_calibrated_with_the_visibilities(self, read, tmp_path):
        """Raw data and gains weigh as the calibrated data do, up to the gains' own power."""
        uv = make_uvdata()
        cal = make_uvcal(uv)
        cal.flag_array[:] = False
        cal.write_calfits(str(tmp_path / "gains.calfits"), run_check=False)
        true = radiometer_weights(*self._order(*read(uv)))
        power = np.abs(cal.gain_array) ** 2
        raw = uv.copy()
        for row in range(uv.Nblts):
            i, j = NUMBERS.index(uv.ant_1_array[row]), NUMBERS.index(uv.ant_2_array[row])
            t = round((uv.time_array[row] - T0) / (10 * SECOND))
            raw.data_array[row] *= np.sqrt(power[i, :, t] * power[j, :, t])
        found = radiometer_weights(*self._order(*read(raw)), [tmp_path / "gains.calfits"])
        np.testing.assert_allclose(found, true, rtol=1e-12)

    @staticmethod
    def _order(obs, flags, nsamples, files):
        return files, obs, whole(obs), flags, nsamples

    @pytest.mark.parametrize("power", [0.0, -5.0])
    def test_an_autocorrelation_without_power_gives_no_weight(self, read, power):
        uv = make_uvdata()
        uv.data_array[(uv.ant_1_array == 7) & (uv.ant_2_array == 7)] = power
        obs, flags, nsamples, files = read(uv)
        weights = radiometer_weights(files, obs, whole(obs), flags, nsamples)
        with_7 = (obs.antpairs == 7).any(axis=1)
        assert not weights[:, :, with_7].any()
        assert weights[:, :, ~with_7].any()
        assert np.isfinite(weights).all()

    def test_an_autocorrelation_that_is_missing_is_an_error(self, read):
        obs, flags, nsamples, files = read(make_uvdata(antpairs=CROSS + AUTOS[:4]))
        with pytest.raises(InputError, match="no autocorrelations of antenna 3 or 41"):
            radiometer_weights(files, obs, whole(obs), flags, nsamples)
        # Where nothing is observed with it, it is not missed.
        flags[:, :, (obs.antpairs == 41).any(axis=1)] = True
        assert radiometer_weights(files, obs, whole(obs), flags, nsamples).any()

    @pytest.mark.parametrize("field", ["integration_time", "channel_width"])
    def test_needs_an_exposure(self, read, field):
        obs, flags, nsamples, files = read(make_uvdata())
        obs = dataclasses.replace(obs, **{field: 0 * getattr(obs, field)})
        with pytest.raises(InputError, match=f"{field}: not positive"):
            radiometer_weights(files, obs, whole(obs), flags, nsamples)


def test_constant_noise():
    flags = np.array([False, True, False])
    weights = constant_weights(0.5, flags, np.array([2.0, 2.0, 0.0]))
    assert weights.tolist() == [4.0, 0.0, 0.0]
    with pytest.raises(InputError, match=r"\[noise\] sigma: must be positive"):
        constant_weights(0.0, flags, np.ones(3))


@pytest.mark.parametrize(
    ("unflagged", "weighted", "message"),
    [(0, 0, "all selected data are flagged"), (5, 0, "non-positive noise")],
)
def test_data_that_say_nothing_are_refused(tmp_path, unflagged, weighted, message):
    check_weights(5, 1, [tmp_path])
    with pytest.raises(InputError, match=message):
        check_weights(unflagged, weighted, [tmp_path])


class TestFile:
    def test_of_a_sigma_for_every_visibility(self, read):
        uv = make_uvdata()
        obs, flags, nsamples, _ = read(uv)
        sigma = uv.copy()
        sigma.data_array = np.random.default_rng(4).uniform(1, 2, uv.data_array.shape) + 0j
        sigma.flag_array = np.roll(uv.flag_array, 5)
        *_, files = read(sigma, name="sigma.uvh5")
        found = file_weights(files[0], obs, whole(obs), flags, nsamples)
        for b, pair in enumerate(obs.antpairs.tolist()):
            for p, pol in enumerate(obs.pols):
                wanted = sigma.get_data(*pair, pol).real.T ** -2.0
                bad = sigma.get_flags(*pair, pol).T | flags[..., b, p]
                np.testing.assert_allclose(found[..., b, p], np.where(bad, 0, wanted), rtol=1e-14)

    def test_must_hold_every_visibility(self, read):
        obs, flags, nsamples, _ = read(make_uvdata())
        *_, files = read(make_uvdata(antpairs=CROSS[:5]), name="sigma.uvh5")
        with pytest.raises(InputError, match="lacks a sigma of an unflagged visibility"):
            file_weights(files[0], obs, whole(obs), flags, nsamples)

    @pytest.mark.parametrize("extension", ["h5", "npz"])
    @pytest.mark.parametrize("by_antenna", [False, True])
    def test_of_a_sigma_of_one_sample(self, read, tmp_path, extension, by_antenna):
        obs, flags, nsamples, _ = read(make_uvdata(), Selection(freq_range=(121e6, 123e6)))
        freqs = np.array([123e6, 122e6, 121e6 + 4e5, 120e6])
        table = {"freqs": freqs, "sigma": np.array([3.0, 2.0, 1.0, 9.0])}
        if by_antenna:
            table |= {
                "antennas": np.array(NUMBERS[::-1]),
                "sigma": np.arange(1.0, 6)[:, None] * table["sigma"],
            }
        path = write_table(tmp_path / f"sigma.{extension}", table)
        found = file_weights(
            path, obs, Tile(np.arange(6), np.array([4, 1])), flags[:, :, [4, 1]], nsamples[:, :, [4, 1]]
        )
        for i, b in enumerate((4, 1)):
            scale = np.prod([5 - NUMBERS.index(ant) for ant in obs.antpairs[b]]) if by_antenna else 1.0
            variance = scale * np.array([1.0, 4.0, 9.0])[:, None, None]
            wanted = np.where(flags[:, :, b], 0, nsamples[:, :, b] / variance)
            np.testing.assert_allclose(found[:, :, i], wanted, rtol=1e-14)

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"sigma": None}, "cannot be read as uvh5|not a uvh5"),
            ({"freqs": None}, "freqs: is missing"),
            ({"freqs": np.array([120e6, 121e6, 122e6, 124e6])}, "no sigma at 123.000000 MHz"),
            ({"sigma": np.array([1.0, 0.0, 1.0, 1.0])}, "a sigma that is not positive"),
            ({"sigma": np.array([1.0, np.nan, 1.0, 1.0])}, "a sigma that is not positive"),
            ({"sigma": np.ones((4, 4))}, "antennas: is missing"),
            ({"sigma": np.ones((4, 4)), "antennas": np.array(NUMBERS[:4])}, "no sigma of antenna 41"),
        ],
    )
    def test_that_lacks_something_is_refused(self, read, tmp_path, change, message):
        obs, flags, nsamples, _ = read(make_uvdata())
        table = {"freqs": obs.freqs, "sigma": np.ones(4)} | change
        path = write_table(
            tmp_path / "sigma.h5", {key: value for key, value in table.items() if value is not None}
        )
        with pytest.raises(InputError, match=message):
            file_weights(path, obs, whole(obs), flags, nsamples)

    def test_that_is_missing_or_something_else_is_refused(self, read, tmp_path):
        obs, flags, nsamples, _ = read(make_uvdata())
        with pytest.raises(InputError, match=r"\[noise\] file: no such file"):
            file_weights(tmp_path / "sigma.npz", obs, whole(obs), flags, nsamples)
        (tmp_path / "sigma.npz").write_text("1.0")
        with pytest.raises(InputError, match="not a uvh5"):
            file_weights(tmp_path / "sigma.npz", obs, whole(obs), flags, nsamples)


def write_table(path, table):
    if path.suffix == ".npz":
        np.savez(path, **table)
    else:
        with h5py.File(path, "w") as file:
            for name, values in table.items():
                file[name] = values
    return path


def noisy(n_times, n_freqs=4, seed=3, times=None):
    """Noise of variance 2 (b + 1) Jy^2 a sample for baseline b of `CROSS`, on a drifting sky of 50 Jy."""
    times = T0 + 10 * SECOND * np.arange(n_times) if times is None else times
    uv = make_uvdata(times=times, antpairs=CROSS, freqs=120e6 + 1e6 * np.arange(n_freqs), seed=seed)
    rng = np.random.default_rng(seed)
    unit = rng.normal(size=(2, *uv.data_array.shape)) * np.sqrt(0.5)
    pairs = zip(uv.ant_1_array, uv.ant_2_array, strict=True)
    variance = 2.0 * np.array([CROSS.index(pair) + 1 for pair in pairs])[:, None, None] / uv.nsample_array
    step = (uv.time_array - T0)[:, None, None] / (10 * SECOND)
    uv.data_array = 50 + 15j + 2 * step + np.sqrt(variance) * (unit[0] + 1j * unit[1])
    return uv


class TestDifferences:
    def variance_of(self, obs):
        return np.array([2.0 * (CROSS.index(tuple(pair)) + 1) for pair in obs.antpairs.tolist()])

    def test_in_time_find_the_noise_below_a_drifting_sky(self, read):
        obs, _, _, files = read(noisy(400))
        found = difference_variance(files, obs, np.arange(6), "time")
        assert found.shape == (4, 6, 2)
        # 10% of the samples are flagged, so 0.9^3 of 398 differences remain, correlated with neighbours:
        # the sum of squared correlations (1, 4/6, 1/6) doubles the variance of the estimate.
        error = np.sqrt(2 / (0.73 * 398))
        z = (found / self.variance_of(obs)[:, None] - 1) / error
        assert np.abs(z).max() < 4.5
        assert abs(z.mean()) < 4.5 / np.sqrt(z.size)
        assert 0.6 < z.std() < 1.4

    def test_in_frequency_find_the_noise_of_a_smooth_spectrum(self, read):
        obs, _, _, files = read(noisy(100, n_freqs=12))
        found = difference_variance(files, obs, np.arange(6), "frequency")
        ratio = found / self.variance_of(obs)[:, None]
        assert found.shape == (12, 6, 2)
        assert abs(ratio.mean() - 1) < 4.5 * np.sqrt(2 / (0.73 * 10 * 100 * 12))
        assert np.abs(ratio - 1).max() < 4.5 * np.sqrt(2 / (0.73 * 100))

    def test_do_not_depend_on_how_baselines_are_dealt_out(self, read):
        obs, _, _, files = read(noisy(20))
        for how in ("time", "frequency"):
            everything = difference_variance(files, obs, np.arange(6), how)
            parts = [difference_variance(files, obs, np.array(bls), how) for bls in ([4], [0, 5], [2, 1, 3])]
            np.testing.assert_array_equal(np.concatenate(parts, axis=1), everything[:, [4, 0, 5, 2, 1, 3]])

    def test_do_not_reach_over_gaps(self, read):
        """Two nights, with a sky that jumps between them: each contributes as if alone."""
        night = T0 + 10 * SECOND * np.arange(12)
        both = noisy(24, times=np.concatenate([night, night + 1]))
        both.flag_array[:] = False
        both.data_array[both.time_array > T0 + 0.5] += 1e4
        obs, _, _, files = read(both)
        alone = []
        for half in (slice(0, 12), slice(12, 24)):
            axes = {name: getattr(obs, name)[half] for name in ("times", "lsts", "integration_time")}
            alone.append(difference_variance(files, dataclasses.replace(obs, **axes), np.arange(6), "time"))
        found = difference_variance(files, obs, np.arange(6), "time")
        np.testing.assert_allclose(found, np.mean(alone, axis=0), rtol=1e-12)
        assert found.max() < 100

    def test_with_too_few_unflagged_are_infinite(self, read):
        uv = noisy(20)
        uv.flag_array[:] = False
        uv.flag_array[uv.time_array > T0 + 85 * SECOND, 2, 0] = True
        obs, flags, nsamples, files = read(uv)
        found = difference_variance(files, obs, np.arange(6), "time")
        assert np.isinf(found[2, :, 0]).all()
        assert np.isfinite(found).sum() == found.size - 6
        weights = variance_weights(found, flags, nsamples)
        assert not weights[2, ..., 0].any()
        np.testing.assert_allclose(weights[1], nsamples[1] / found[1], rtol=1e-14)
        assert not weights[flags].any()

    def test_are_those_of_the_calibrated_data(self, read, tmp_path):
        uv = noisy(20)
        cal = make_uvcal(uv, times=np.array([T0]))
        cal.gain_array[:], cal.flag_array[:] = 2.0j, False
        cal.write_calfits(str(tmp_path / "gains.calfits"), run_check=False)
        obs, _, _, files = read(uv)
        plain = difference_variance(files, obs, np.arange(6), "time")
        calibrated = difference_variance(files, obs, np.arange(6), "time", [tmp_path / "gains.calfits"])
        np.testing.assert_allclose(calibrated, plain / 16, rtol=1e-12)

    @pytest.mark.parametrize(
        ("selection", "how"),
        [
            (Selection(every_time=3), "time"),
            (Selection(time_range=(T0 - 1, T0 + 85 * SECOND)), "time"),
            (Selection(channels=(0, 1)), "frequency"),
            (Selection(channels=(0, 3)), "frequency"),
        ],
    )
    def test_of_samples_too_far_apart_are_refused(self, read, selection, how):
        obs, _, _, files = read(noisy(40), selection)
        with pytest.raises(InputError, match=r"\[noise\] kind: too few adjacent"):
            difference_variance(files, obs, np.arange(6), how)


class TestMeasured:
    """What differences say of the noise is what the radiometer equation says."""

    def ratio(self, files, obs, how):
        _, flags, nsamples = read_visibilities(files, obs, whole(obs))
        radiometer = radiometer_weights(files, obs, whole(obs), flags, nsamples)
        differences = variance_weights(
            difference_variance(files, obs, np.arange(obs.Nbls), how), flags, nsamples
        )
        used = (radiometer > 0) & (differences > 0)
        assert used.mean() > 0.5
        return np.sqrt(np.median(differences[used]) / np.median(radiometer[used]))

    def test_three_nights_have_the_noise_of_narrow_channels(self, data_dir):
        files = sorted((data_dir / "H1C_2458043-45_LST1.1").glob("*.XRAA.uvh5"))
        obs = read_observation(files, Selection(freq_range=(130e6, 190e6)))
        narrow = dataclasses.replace(obs, channel_width=np.full(obs.Nfreqs, 97656.25))
        assert 0.8 < self.ratio(files, narrow, "time") < 1.25

    @pytest.mark.parametrize("how", ["time", "frequency"])
    def test_binned_nights_scale_with_nsamples(self, data_dir, how):
        files = sorted((data_dir / "H1C_lstbin_LST4.95").iterdir())[:1]
        obs = read_observation(files, Selection())
        assert 0.8 < self.ratio(files, obs, how) < 1.25
