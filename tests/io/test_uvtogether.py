"""Files that do and do not fit together, as pyuvdata writes them."""

from __future__ import annotations

import numpy as np
import pytest

from hydrabeam_mpi.data.selection import Selection
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.io.uvdata import read_observation
from tests.visibilities import AUTOS, CROSS, ENU, SECOND, make_uvdata

START = 2459866.2
CHUNK = 20 * SECOND


@pytest.fixture
def write(tmp_path):
    """Function that writes a uvh5 file without any check of its content."""

    def write(uv, name):
        uv.write_uvh5(str(tmp_path / name), run_check=False)
        return tmp_path / name

    return write


@pytest.fixture
def chunks(write):
    """Function that writes files of two integrations each, by their numbers."""
    return lambda *numbers, **given: [write(make_uvdata(times=times_of(n), **given), f"{n}.uvh5") for n in numbers]


def times_of(chunk: float) -> np.ndarray:
    return START + chunk * CHUNK + 10 * SECOND * np.arange(2)


def doubts(files, **selection) -> tuple[str, ...]:
    return read_observation(files, Selection(**selection)).doubts


def test_chunks_of_time_and_of_the_band_leave_no_doubt(chunks, write):
    assert doubts(chunks(0, 1, 2)) == ()
    freqs = [make_uvdata(freqs=120e6 + 1e6 * (4 * k + np.arange(4))) for k in (2, 0, 1)]
    assert doubts([write(uv, f"f{k}.uvh5") for k, uv in enumerate(freqs)]) == ()


def test_a_file_missing_amid_a_night_is_told(chunks):
    files = chunks(0, 1, 2, 5, 6)
    (told,) = doubts(files)
    assert told.startswith("No file holds the 50 s between 2.uvh5 and 5.uvh5 (JD 2459866.20058 to 2459866.20116)")
    assert doubts(files, time_range=(START, START + 3 * CHUNK)) == ()


def test_one_file_missing_among_three_is_told(chunks):
    (told,) = doubts(chunks(0, 1, 3))
    assert told.startswith("No file holds the 30 s between 1.uvh5 and 3.uvh5")


@pytest.mark.parametrize("numbers", [(0, 3), (0, 10, 20), (0, 1, 2, 4320, 4321, 4322)])
def test_files_that_are_apart_by_choice_or_by_day_are_not_missing(chunks, numbers):
    assert doubts(chunks(*numbers)) == ()


def test_a_file_missing_amid_the_band_is_told(write):
    parts = [make_uvdata(freqs=120e6 + 1e6 * (4 * k + np.arange(4))) for k in (0, 1, 3, 4)]
    (told,) = doubts([write(uv, f"{k}.uvh5") for k, uv in enumerate(parts)])
    assert told.startswith("No file holds the channels between 1.uvh5 and 2.uvh5 (127 to 132 MHz)")


def test_another_order_than_that_of_time_is_told(chunks):
    (told,) = doubts(chunks(0, 2, 1))
    assert told.startswith("1.uvh5 begins before 2.uvh5, which is named ahead of it")


def test_an_antenna_that_some_files_lack_is_told(chunks):
    files = [*chunks(0), *chunks(1, antpairs=((3, 7), (7, 20), (20, 11), (3, 11)))]
    assert doubts(files) == ("Antenna 41 has data in only some of the files: what the others lack counts as flagged.",)
    assert doubts(files, exclude_antennas=(41,)) == ()


def test_files_of_other_baselines_leave_no_doubt(chunks, write):
    rest = write(make_uvdata(times=times_of(0), antpairs=CROSS[3:]), "b.uvh5")
    assert doubts([*chunks(0, antpairs=CROSS[:3]), rest]) == ()


def averaged(n: int, of: str):
    """Return the means of every ``n`` integrations or channels beside what they are made of."""
    raw, mean = make_uvdata(times=START + 10 * SECOND * np.arange(6), freqs=120e6 + 1e6 * np.arange(6)), None
    if of == "times":
        times = raw.time_array[:: raw.Nbls].reshape(-1, n).mean(axis=1)
        mean = make_uvdata(times=times, freqs=raw.freq_array)
        mean.integration_time[:] = 10.0 * n
    else:
        mean = make_uvdata(times=START + 10 * SECOND * np.arange(6), freqs=raw.freq_array.reshape(-1, n).mean(axis=1))
        mean.channel_width[:] = 1e6 * n
    return raw, mean


@pytest.mark.parametrize("of", ["times", "channels"])
@pytest.mark.parametrize("n", [2, 3])
def test_data_and_their_means_are_not_taken_for_two(write, of, n):
    files = [write(uv, name) for uv, name in zip(averaged(n, of), ("raw.uvh5", "mean.uvh5"), strict=True)]
    with pytest.raises(InputError, match=r"mean\.uvh5: time_array: holds data that raw\.uvh5 holds too.*remove one"):
        read_observation(files, Selection())


def test_overlapping_chunks_are_refused_unless_their_rows_differ(write):
    first = make_uvdata(times=START + 10 * SECOND * np.arange(3))
    overlapping = make_uvdata(times=START + 10 * SECOND * np.arange(2, 5))
    with pytest.raises(InputError, match=r"b\.uvh5: time_array: holds data that a\.uvh5 holds too, from JD 2459"):
        read_observation([write(first, "a.uvh5"), write(overlapping, "b.uvh5")], Selection())
    # One has some baselines at the time that both have, and the other has the others.
    shared = START + 20 * SECOND
    drop = np.isin(overlapping.baseline_array, first.baseline_array[:4]) & np.isclose(overlapping.time_array, shared)
    rest = overlapping.select(blt_inds=np.flatnonzero(~drop), inplace=False)
    keep = np.isin(first.baseline_array, first.baseline_array[:4]) | ~np.isclose(first.time_array, shared)
    part = first.select(blt_inds=np.flatnonzero(keep), inplace=False)
    assert read_observation([write(part, "c.uvh5"), write(rest, "d.uvh5")], Selection()).Ntimes == 5


def test_a_thinned_file_and_what_was_left_out_are_two(write):
    """Headers of thinned files may state the distance to the next channel for a width."""
    whole = make_uvdata(freqs=120e6 + 1e6 * np.arange(6))
    files = []
    for k in range(2):
        part = whole.select(freq_chans=np.arange(k, 6, 2), inplace=False)
        part.channel_width[:] = 2e6
        files.append(write(part, f"{k}.uvh5"))
    assert read_observation(files, Selection()).Nfreqs == 6


def test_an_antenna_of_another_number_is_told(chunks, write):
    other = make_uvdata(times=times_of(1))
    other.telescope.antenna_numbers = np.array([3, 7, 11, 20, 42])
    for array in (other.ant_1_array, other.ant_2_array):
        array[array == 41] = 42
    other.baseline_array = other.antnums_to_baseline(other.ant_1_array, other.ant_2_array)
    with pytest.raises(InputError, match=r"1\.uvh5: antenna_numbers: antenna 42 stands where 0\.uvh5 has antenna 41"):
        read_observation([*chunks(0), write(other, "1.uvh5")], Selection())


def test_antennas_without_data_may_share_a_place(chunks):
    nowhere = ENU.copy()
    nowhere[3:] = 0
    pairs = ((3, 7), (3, 11), (7, 11), *AUTOS[:3])
    assert doubts(chunks(0, 1, antpairs=pairs, enu=nowhere)) == ()
