"""One file: its format, what it says, and what is refused."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from astropy.io import fits

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.uvfile import may_hold, read_metadata
from tests.visibilities import ENU, make_uvdata


def written(uv, path: Path) -> Path:
    uv.write_uvh5(str(path), run_check=False)
    return path


def test_metadata_are_those_of_the_file(tmp_path):
    uv = make_uvdata()
    header, rows = read_metadata(written(uv, tmp_path / "a.uvh5"))
    assert header.kind == "uvh5"
    assert header.telescope_name == "made"
    np.testing.assert_array_equal(header.freqs, uv.freq_array)
    np.testing.assert_array_equal(header.channel_width, uv.channel_width)
    np.testing.assert_array_equal(rows.times, uv.time_array)
    np.testing.assert_array_equal(rows.lsts, uv.lst_array)
    np.testing.assert_array_equal(rows.integration_time, uv.integration_time)
    np.testing.assert_array_equal(rows.antpairs[:, 0], uv.ant_1_array)
    np.testing.assert_array_equal(rows.antpairs[:, 1], uv.ant_2_array)
    assert header.pols == ("ee", "nn")
    assert header.feed_pols == ("xx", "yy")
    assert header.antenna_names == ("A3", "A7", "A11", "A20", "A41")


def test_antenna_positions_keep_their_precision(tmp_path):
    """A picometre, where adding the Earth's radius would leave a nanometre."""
    header, _ = read_metadata(written(make_uvdata(), tmp_path / "a.uvh5"))
    np.testing.assert_allclose(header.antpos, ENU, rtol=0, atol=1e-12)


def test_antenna_positions_agree_with_pyuvdata(tmp_path):
    uv = make_uvdata()
    header, _ = read_metadata(written(uv, tmp_path / "a.uvh5"))
    np.testing.assert_allclose(header.antpos, uv.telescope.get_enu_antpos(), rtol=0, atol=1e-8)


@pytest.mark.parametrize(
    ("orientation", "pols"), [("east", ("ee", "nn")), ("north", ("nn", "ee")), (None, ("xx", "yy"))]
)
def test_polarisations_are_named_by_direction_where_known(tmp_path, orientation, pols):
    header, _ = read_metadata(written(make_uvdata(x_orientation=orientation), tmp_path / "a.uvh5"))
    assert header.pols == pols
    assert [header.pol_index(pol) for pol in (*pols, "xx", "yy", "en")] == [0, 1, 0, 1, -1]


def test_a_telescope_name_that_no_file_could_take_is_written_out(tmp_path):
    path = written(make_uvdata(), tmp_path / "data.uvh5")
    with h5py.File(path, "r+") as file:
        del file["Header/telescope_name"]
        file["Header/telescope_name"] = np.bytes_(b"HE\0RA\n")
    header, _ = read_metadata(path)
    assert header.telescope_name == r"HE\x00RA\n"


def test_a_file_at_other_times_is_passed_over(tmp_path):
    uv = make_uvdata()
    path = written(uv, tmp_path / "a.uvh5")
    assert may_hold(path, uv.time_array[-1:] + 1e-9, uv.freq_array[:1] + 1e-3)
    assert not may_hold(path, uv.time_array[-1:] + 1.0, uv.freq_array)
    assert not may_hold(path, uv.time_array, uv.freq_array + 1e5)


def _missing(path):
    return "no such file"


def _empty(path):
    path.write_bytes(b"")
    return "empty"


def _text(path):
    path.write_text("1 2 3")
    return "not a uvh5"


def _directory(path):
    path.mkdir()
    return "holds no visibilities"


def _truncated(path):
    written(make_uvdata(), path)
    with path.open("r+b") as file:
        file.truncate(path.stat().st_size * 2 // 3)
    return r"cannot be read as uvh5 \(truncated file"


def _other_hdf5(path):
    with h5py.File(path, "w") as file:
        file["beam"] = 1.0
    return "not a uvh5"


def _no_metadata(path):
    written(make_uvdata(), path)
    with h5py.File(path, "r+") as file:
        del file["Header/ant_1_array"]
    return "cannot be read as uvh5"


def _image_fits(path):
    fits.PrimaryHDU(np.zeros((3, 3))).writeto(path)
    return "cannot be read as uvfits"


def _truncated_fits(path):
    uv = make_uvdata()
    uv.phase(lon=1.3, lat=-0.6, cat_name="somewhere", phase_frame="icrs")
    uv.write_uvfits(str(path))
    with path.open("r+b") as file:
        file.truncate(path.stat().st_size // 3)
    return "cannot be read as uvfits"


def _kelvin(path):
    uv = make_uvdata()
    uv.vis_units = "K str"
    written(uv, path)
    return "vis_units"


def _negative_frequency(path):
    uv = make_uvdata()
    uv.freq_array[2] = -1e8
    written(uv, path)
    return "freq_array"


def _nan_frequency(path):
    uv = make_uvdata()
    uv.freq_array[2] = np.nan
    written(uv, path)
    return "freq_array"


def _a_window_and_its_mean(path):
    uv = make_uvdata(freqs=np.array([120e6, 121e6, 122e6, 121e6]))
    uv.channel_width[3] = 3e6
    uv.flex_spw_id_array = np.array([0, 0, 0, 1])
    uv.spw_array, uv.Nspws = np.array([0, 1]), 2
    written(uv, path)
    return "spw_array: windows 0 and 1 both have the data at 121.000000 MHz; keep one with"


def _varying_polarisation(path):
    uv = make_uvdata(pols=(-5,))
    uv.flex_spw_id_array = np.array([0, 0, 1, 1])
    uv.spw_array, uv.Nspws = np.array([0, 1]), 2
    uv.flex_spw_polarization_array, uv.polarization_array = np.array([-5, -6]), np.array([0])
    written(uv, path)
    return "polarisation varies"


@pytest.mark.parametrize(
    "spoil",
    [
        _missing, _empty, _text, _directory, _truncated, _other_hdf5, _no_metadata, _image_fits,
        _truncated_fits, _kelvin, _negative_frequency, _nan_frequency, _a_window_and_its_mean,
        _varying_polarisation,
    ],
)  # fmt: skip
def test_bad_file_is_one_line_that_names_it(tmp_path, spoil):
    path = tmp_path / "bad.uvh5"
    message = spoil(path)
    with pytest.raises(InputError, match=message) as caught:
        read_metadata(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
