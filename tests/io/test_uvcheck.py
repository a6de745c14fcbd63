"""Metadata that cannot be so are refused by name, whether or not a reader would have noticed."""

from __future__ import annotations

import h5py
import numpy as np
import pytest

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.uvfile import read_metadata
from tests.visibilities import make_uvdata


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """A uvh5 file that has nothing wrong, as bytes."""
    path = tmp_path_factory.mktemp("sound") / "a.uvh5"
    make_uvdata().write_uvh5(str(path), run_check=False)
    return path.read_bytes()


@pytest.fixture
def path(sound, tmp_path):
    (tmp_path / "a.uvh5").write_bytes(sound)
    return tmp_path / "a.uvh5"


def edit(path, name, values):
    with h5py.File(path, "r+") as file:
        group = file["Header"] if name in file["Header"] else file["Data"]
        old = group[name][()]
        new = np.array(values(old) if callable(values) else np.full_like(old, values))
        del group[name]
        group[name] = new


def one_bad(value):
    """Replace the last number."""

    def change(old):
        new = np.array(old, dtype=float)
        new.ravel()[-1] = value
        return new

    return change


def without_last(old):
    return old[:-1]


@pytest.mark.parametrize(
    ("name", "values", "words"),
    [
        ("time_array", lambda old: old - 2400000.5, ["time_array: 59865.7 is no Julian date", "add 2400000.5"]),
        ("time_array", lambda old: old + 1e5, ["no Julian date from 1962 to 2100", "write them as Julian dates"]),
        ("time_array", lambda old: old - 1e5, ["no Julian date from 1962 to 2100", "write them as Julian dates"]),
        ("time_array", 0.0, ["time_array: 0 is no Julian date", "write them as Julian dates (UTC)"]),
        ("time_array", one_bad(2400.0), ["time_array: 2400 is no Julian date"]),
        ("lst_array", one_bad(np.nan), ["lst_array: a sidereal time that is nan", "set_lsts_from_time_array()"]),
        ("integration_time", one_bad(-10.0), ["integration_time: an integration of -10 s", "correct the file"]),
        ("integration_time", one_bad(np.nan), ["integration_time: an integration of nan s"]),
        ("integration_time", one_bad(np.inf), ["integration_time: an integration of inf s"]),
        ("latitude", np.nan, ["telescope_location: not a place on Earth", "NaN or infinite", "correct where"]),
        ("altitude", -6.3e6, ["telescope_location: not a place on Earth", "height -6.3e+06 m"]),
        ("altitude", 1e9, ["telescope_location: not a place on Earth", "height 1e+09 m"]),
        ("antenna_positions", one_bad(1e20), ["antenna_positions: antenna 41 stands 1e+20 m from the telescope"]),
        ("freq_array", one_bad(np.inf), ["freq_array: a frequency of inf Hz"]),
        ("freq_array", one_bad(1e300), ["freq_array: a frequency of 1e+300 Hz"]),
        (
            "channel_width",
            one_bad(1e300),
            ["channel_width: a channel of 1e+300 Hz at 123 MHz, which would"],
        ),
        ("polarization_array", -5, ["polarization_array: a polarisation stands twice"]),
        ("polarization_array", one_bad(9), ["polarization_array: no polarisation has the code 9"]),
        ("Nblts", 60, ["time_array: 66 numbers, where the header says 60"]),
        ("Nblts", 99, ["time_array: 66 numbers, where the header says 99"]),
        ("Nfreqs", 3, ["freq_array: 4 numbers, where the header says 3"]),
        ("antenna_positions", without_last, ["antenna_positions: 4 x 3 numbers, where the header says 5 x 3"]),
        ("antenna_names", without_last, ["antenna_names: 4 names of antennas, not one for each"]),
        ("visdata", without_last, ["Data/visdata: 65 x 4 x 2 samples, where the header says 66 x 4 x 2"]),
        ("flags", lambda old: old[:, :-1], ["Data/flags: 66 x 3 x 2 samples, where the header says 66 x 4 x 2"]),
        ("nsamples", lambda old: old[..., :1], ["Data/nsamples: 66 x 4 x 1 samples"]),
    ],
)
def test_what_cannot_be_is_refused_by_name(path, name, values, words):
    read_metadata(path)
    edit(path, name, values)
    with pytest.raises(InputError) as caught:
        read_metadata(path)
    assert [word for word in [str(path), *words] if word not in str(caught.value)] == []


def test_samples_with_an_axis_of_one_spectral_window_are_as_good(path):
    for name in ("visdata", "flags", "nsamples"):
        edit(path, name, lambda old: old[:, np.newaxis])
    read_metadata(path)


def test_an_antenna_without_position_may_stay_unused(path):
    edit(path, "antenna_positions", one_bad(np.nan))
    read_metadata(path)
