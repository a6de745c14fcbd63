"""Gains written are what pyuvdata reads and applies."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pyuvdata import UVCal, UVData
from pyuvdata.utils import get_lst_for_time, uvcalibrate

from hydrabeam_mpi.data.observation import Observation
from hydrabeam_mpi.io.calwrite import write_gains
from hydrabeam_mpi.io.uvwrite import write_uvh5
from tests.io.test_uvwrite import make
from tests.visibilities import LOCATION


def even(observation: Observation) -> Observation:
    """Five integrations of one length, and three neighbouring channels."""
    return replace(
        observation,
        integration_time=np.full(5, 10.7),
        freqs=131e6 + 1e5 * np.arange(3),
        channel_width=np.full(3, 1e5),
    )


def check_applied(observation: Observation, folder: Path, name: str) -> UVCal:
    """Write data and gains, apply these by pyuvdata, and return them."""
    data, flags, nsamples = (part[..., : len(observation.pols)] for part in make()[1:4])
    write_uvh5(folder / "data.uvh5", observation, data, flags, nsamples)
    rng = np.random.default_rng(4)
    shape = (observation.Nfreqs, observation.Ntimes, observation.Nants)
    gains = rng.normal(1, 0.1, shape) + 1j * rng.normal(0, 0.1, shape)
    write_gains(folder, observation, gains, "A history.")
    assert {path.name for path in folder.iterdir()} == {"data.uvh5", name}
    cal = UVCal.from_file(str(folder / name))
    assert "A history." in cal.history
    uvd = UVData.from_file(folder / "data.uvh5")
    uvcalibrate(uvd, cal)
    for number, (one, two) in enumerate(observation.antpairs.tolist()):
        i, j = np.searchsorted(observation.antenna_numbers, [one, two])
        expected = data[:, :, number] / (gains[:, :, i] * gains[:, :, j].conj())[..., np.newaxis]
        np.testing.assert_allclose(uvd.get_data(one, two, squeeze="none"), expected.swapaxes(0, 1), rtol=1e-12)
    return cal


@pytest.mark.parametrize(
    ("pols", "jones"),
    [(("ee", "nn"), [-5, -6]), (("nn",), [-6]), (("xx",), [-5]), (("xx", "yy"), [-5, -6]), (("yy",), [-6])],
)
def test_gains_divide_data_of_the_same_feeds(pols: tuple[str, ...], jones: list[int], tmp_path: Path) -> None:
    """Also where a file does not tell where its feeds point."""
    cal = check_applied(even(make(pols)[0]), tmp_path, "gains.calfits")
    assert cal.jones_array.tolist() == jones
    assert ("x is written as East" in cal.history) == (pols[0][0] in "xy")


@pytest.mark.parametrize("gap", ["in frequency", "in time"])
def test_gains_with_a_gap_keep_their_times_and_channels(gap: str, tmp_path: Path) -> None:
    """As of two nights, or of chosen channels: calfits would move them, and say nothing."""
    observation = even(make()[0])
    if gap == "in time":
        times = observation.times + np.where(np.arange(5) > 2, 0.9972, 0.0)
        observation = replace(observation, times=times, lsts=get_lst_for_time(times, telescope_loc=LOCATION))
    else:
        observation = replace(observation, freqs=np.array([131e6, 132e6, 140e6]))
    cal = check_applied(observation, tmp_path, "gains.calh5")
    np.testing.assert_array_equal(cal.freq_array, observation.freqs)
    np.testing.assert_array_equal(cal.time_array, observation.times)


@pytest.mark.parametrize("stated", ["sum", "avg"])
def test_gains_are_of_the_convention_of_the_data(stated: str, tmp_path: Path) -> None:
    """Pyuvdata applies them to these alone."""
    observation = replace(even(make()[0]), stated_conventions=(stated,))
    write_gains(tmp_path, observation, np.ones((3, 5, observation.Nants), dtype=complex), "")
    assert UVCal.from_file(str(tmp_path / "gains.calfits")).pol_convention == stated
