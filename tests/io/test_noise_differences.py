"""The noise from differences of neighbouring samples, of mocks and of measured data."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hydrabeam_mpi.data.selection import Selection
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.noise import difference_variance, radiometer_weights, variance_weights
from hydrabeam_mpi.io.uvdata import read_observation, read_visibilities
from tests.visibilities import CROSS, SECOND, make_uvcal, make_uvdata, whole

T0 = 2459866.2


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
            parts = [
                difference_variance(files, obs, np.array(bls, dtype=int), how) for bls in ([4], [0, 5], [], [2, 1, 3])
            ]
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

    def test_of_data_without_noise_are_refused(self, read):
        uv = noisy(20)
        uv.data_array[:] = 1.0
        obs, flags, nsamples, files = read(uv)
        variance = difference_variance(files, obs, np.arange(6), "time")
        with pytest.raises(InputError, match="non-positive noise"):
            variance_weights(variance, flags, nsamples)

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

    def test_of_a_channel_apart_are_refused(self, read):
        obs, _, _, files = read(noisy(40, n_freqs=7), Selection(channels=(0, 1, 2, 3, 6)))
        with pytest.raises(InputError, match=r"channels without neighbours .* to: 126 MHz; select their"):
            difference_variance(files, obs, np.arange(6), "frequency")


class TestMeasured:
    """What differences say of the noise is what the radiometer equation says."""

    def ratio(self, files, obs, how):
        _, flags, nsamples = read_visibilities(files, obs, whole(obs))
        radiometer = radiometer_weights(files, obs, whole(obs), flags, nsamples)
        differences = variance_weights(difference_variance(files, obs, np.arange(obs.Nbls), how), flags, nsamples)
        used = (radiometer > 0) & (differences > 0)
        assert used.mean() > 0.5
        return np.sqrt(np.median(differences[used]) / np.median(radiometer[used]))

    def test_three_nights_have_the_noise_of_narrow_channels(self, data_dir):
        files = sorted((data_dir / "H1C_2458043-45_LST1.1").glob("*.XRAA.uvh5"))
        obs = read_observation(files, Selection(freq_range=(130e6, 190e6)))
        narrow = dataclasses.replace(obs, channel_width=np.full(obs.Nfreqs, 97656.25))
        assert 0.87 < self.ratio(files, narrow, "time") < 1.05

    def test_filtered_data_have_the_noise_of_wide_channels(self, data_dir):
        files = sorted((data_dir / "H1C_2458042_LST5.7").iterdir())
        obs = read_observation(files, Selection(freq_range=(120e6, 190e6), exclude_antennas=(0, 11)))
        wide = dataclasses.replace(obs, channel_width=np.full(obs.Nfreqs, 1.5625e6))
        assert 0.87 < self.ratio(files, wide, "time") < 1.05

    @pytest.mark.parametrize("how", ["time", "frequency"])
    def test_binned_nights_scale_with_nsamples(self, data_dir, how):
        files = sorted((data_dir / "H1C_lstbin_LST4.95").iterdir())[:1]
        obs = read_observation(files, Selection())
        assert 0.87 < self.ratio(files, obs, how) < 1.05
