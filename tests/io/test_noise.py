"""The noise, from whatever tells it."""

from __future__ import annotations

import dataclasses

import h5py
import numpy as np
import pytest

from hydrabeam_mpi.data.partition import Tile
from hydrabeam_mpi.data.selection import Selection
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.noise import check_weights, constant_weights, file_weights, radiometer_weights
from tests.visibilities import AUTOS, CROSS, NUMBERS, SECOND, make_uvcal, make_uvdata, whole

T0 = 2459866.2


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

    def test_of_an_idle_rank_is_empty(self, read):
        obs, _, _, files = read(make_uvdata())
        for tile in (Tile(np.arange(0), np.arange(6)), Tile(np.arange(6), np.arange(0))):
            shape = (4, len(tile.times), len(tile.bls), 2)
            nothing = radiometer_weights(files, obs, tile, np.zeros(shape, bool), np.ones(shape))
            assert nothing.shape == shape

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

    @pytest.mark.parametrize("power", [0.0, -5.0, 1e-35])
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
        obs, flags, nsamples, files = read(make_uvdata(antpairs=CROSS), name="none.uvh5")
        with pytest.raises(InputError, match="no autocorrelations of any antenna; choose another"):
            radiometer_weights(files, obs, whole(obs), flags, nsamples)
        obs, flags, nsamples, files = read(make_uvdata(antpairs=CROSS + AUTOS[:4]), name="again.uvh5")
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
            ({"sigma": np.array([1.0, np.inf, 1.0, 1.0])}, "sigma: a sigma of inf Jy"),
            ({"sigma": -np.ones((5, 4)), "antennas": np.array(NUMBERS)}, "sigma: a sigma of -1 Jy"),
            ({"sigma": np.ones(4, complex)}, "sigma: holds values of type complex128"),
            ({"sigma": np.ones((5, 3)), "antennas": np.array(NUMBERS)}, r"sigma: has the shape \(5, 3\)"),
            ({"freqs": np.array([1e8, 1e8, 2e8, 3e8])}, "freqs: is no list"),
            ({"sigma": np.ones((4, 4)), "antennas": np.array([3, 3, 7, 11])}, "antennas: is no list"),
            ({"sigma": np.ones((4, 4))}, "antennas: is missing"),
            ({"sigma": np.ones((4, 4)), "antennas": np.array(NUMBERS[:4])}, "no sigma of antenna 41"),
        ],
    )
    def test_that_lacks_something_is_refused(self, read, tmp_path, change, message):
        obs, flags, nsamples, _ = read(make_uvdata())
        table = {"freqs": obs.freqs, "sigma": np.ones(4)} | change
        path = write_table(tmp_path / "sigma.h5", {key: value for key, value in table.items() if value is not None})
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
