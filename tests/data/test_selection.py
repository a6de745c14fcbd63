"""Selecting and holding out, on metadata alone."""

from __future__ import annotations

import numpy as np
import pytest
from astropy.coordinates import EarthLocation

from hydrabeam_mpi.data.observation import Observation
from hydrabeam_mpi.data.selection import (
    HoldoutRule,
    Selection,
    distinct,
    in_lst_range,
    match,
    select_baselines,
    select_channels,
    select_times,
    split_holdout,
)
from hydrabeam_mpi.errors import InputError

ANTPAIRS = np.array([[0, 1], [0, 2], [2, 1], [1, 5]])
VECTORS = np.array([[3.0, 4.0, 0.0], [6.0, 8.0, 0.0], [0.0, 0.0, 2.0], [30.0, 40.0, 0.0]])
FREQS = 120e6 + 1e6 * np.arange(5)
WIDTH = np.array([1e6, 1e6, 1e5, 1e6, 1e6])
TIMES = 2459866.0 + 0.1 * np.arange(10)
HOUR = np.pi / 12
LSTS = (22 * HOUR + 0.5 * HOUR * np.arange(10)) % (2 * np.pi)


@pytest.fixture
def obs():
    return Observation(
        telescope_name="made",
        location=EarthLocation.from_geodetic(0, 0),
        antenna_numbers=np.array([0, 1, 2, 5]),
        antenna_names=("0", "1", "2", "5"),
        antpos=np.zeros((4, 3)),
        antpairs=ANTPAIRS,
        freqs=FREQS,
        channel_width=WIDTH,
        times=TIMES,
        lsts=LSTS,
        integration_time=np.full(10, 10.0),
        pols=("ee",),
    )


def test_match_agrees_with_the_definition():
    rng = np.random.default_rng(1)
    values, axis = rng.random((30, 2)), rng.random(17)
    near = np.abs(values[..., None] - axis).argmin(axis=-1)
    far = np.abs(values - axis[near]) > 0.01
    assert 0.1 < far.mean() < 0.9
    np.testing.assert_array_equal(match(values, axis, 0.01), np.where(far, -1, near))
    np.testing.assert_array_equal(match(values, axis, np.where(far, 1.0, 0.01)), near)
    assert match([1.0, 2.0], [], 5.0).tolist() == [-1, -1]
    assert match([1.0, 2.0], [1.5], 0.5).tolist() == [0, 0]


def test_distinct_values_ascend():
    assert distinct([3.0, 1.0, 1.0005, 2.0, 1.0], 1e-3).tolist() == [1, 3, 0]


@pytest.mark.parametrize(
    ("criteria", "kept"),
    [
        ({}, [0, 1, 2, 3]),
        ({"antennas": (0, 1, 2)}, [0, 1, 2]),
        ({"exclude_antennas": (5,)}, [0, 1, 2]),
        ({"antpairs": ((1, 0), (2, 1))}, [0, 2]),
        ({"min_bl_length": 5.0}, [0, 1, 3]),
        ({"max_bl_length": 10.0}, [0, 1, 2]),
        ({"min_bl_length": 4.0, "max_bl_length": 20.0, "exclude_antennas": (2,)}, [0]),
    ],
)
def test_baselines(criteria, kept):
    assert np.flatnonzero(select_baselines(ANTPAIRS, VECTORS, Selection(**criteria))).tolist() == kept


def test_a_baseline_without_vector_is_not_dropped_by_its_length():
    """So that the lack of a position is told, and not hidden."""
    vectors = VECTORS.copy()
    vectors[3] = np.nan
    assert select_baselines(ANTPAIRS, vectors, Selection(min_bl_length=3.0, max_bl_length=7.0)).tolist() == [
        True, False, False, True,
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("criteria", "field"),
    [
        ({"antennas": (0, 5)}, "antennas"),
        ({"exclude_antennas": (0, 1)}, "exclude_antennas"),
        ({"antpairs": ((0, 5),)}, "antpairs"),
        ({"min_bl_length": 51.0}, "min_bl_length"),
        ({"max_bl_length": 1.0}, "max_bl_length"),
        ({"min_bl_length": 20.0, "max_bl_length": 30.0}, "max_bl_length"),
    ],
)
def test_the_criterion_that_leaves_no_baselines_is_named(criteria, field):
    with pytest.raises(InputError, match=rf"^\[data\] {field}: leaves no baselines"):
        select_baselines(ANTPAIRS, VECTORS, Selection(**criteria))


@pytest.mark.parametrize(
    "criteria", [{"antennas": (0, 1, 7)}, {"antpairs": ((0, 1), (0, 7))}, {"exclude_antennas": (0, 7)}]
)
def test_an_antenna_that_does_not_exist_is_named(criteria):
    with pytest.raises(InputError, match="antenna 7 is not in the data"):
        select_baselines(ANTPAIRS, VECTORS, Selection(**criteria))


def test_an_antenna_of_the_array_without_data_may_be_left_out():
    kept = select_baselines(ANTPAIRS, VECTORS, Selection(exclude_antennas=(5, 7)), idle=[5, 7])
    assert np.flatnonzero(kept).tolist() == [0, 1, 2]


@pytest.mark.parametrize(
    ("criteria", "kept"),
    [
        ({}, [0, 1, 2, 3, 4]),
        ({"channels": (3, 0)}, [0, 3]),
        ({"freqs": (121.4e6, 123.5e6)}, [1, 3]),
        ({"freqs": (122.05e6,)}, [2]),
        ({"freq_range": (121e6, 123e6)}, [1, 2, 3]),
        ({"freq_range": (121e6, 123e6), "channels": (0, 2)}, [2]),
    ],
)
def test_channels(criteria, kept):
    assert np.flatnonzero(select_channels(FREQS, WIDTH, Selection(**criteria))).tolist() == kept


@pytest.mark.parametrize(
    ("criteria", "message"),
    [
        ({"channels": (5,)}, r"\[data\] channels: the data have channels 0 to 4"),
        ({"channels": (-1,)}, r"\[data\] channels: the data have channels 0 to 4"),
        (
            {"freqs": (122.06e6,)},
            "no channel within half a channel of 122.060000 MHz; the nearest is 122.000000",
        ),
        ({"freqs": (119.4e6,)}, "no channel within half a channel of 119.400000 MHz"),
        ({"freq_range": (50e6, 60e6)}, r"\[data\] freq_range: leaves no channels \(they span 120 to 124 MHz"),
        ({"freq_range": (123e6, 121e6)}, r"\[data\] freq_range: leaves no channels"),
    ],
)
def test_channels_that_do_not_exist(criteria, message):
    with pytest.raises(InputError, match=message):
        select_channels(FREQS, WIDTH, Selection(**criteria))


def test_lst_range_wraps():
    lsts = np.array([0.0, 1.0, 6.0, 2 * np.pi - 1e-9])
    assert in_lst_range(lsts, (6.0, 0.5)).tolist() == [True, False, True, True]
    assert in_lst_range(lsts, (0.5, 6.0)).tolist() == [False, True, True, False]
    assert in_lst_range(lsts, (0.0, 2 * np.pi)).all()
    assert in_lst_range(lsts, (-0.2, 0.5)).tolist() == [True, False, False, True]


@pytest.mark.parametrize(
    ("criteria", "kept"),
    [
        ({}, list(range(10))),
        ({"time_range": (TIMES[2], TIMES[4])}, [2, 3, 4]),
        ({"lst_range": (23.4 * HOUR, 1.1 * HOUR)}, [3, 4, 5, 6]),
        ({"every_time": 4}, [0, 4, 8]),
        ({"time_range": (TIMES[3], TIMES[9]), "every_time": 3}, [3, 6, 9]),
    ],
)
def test_times(criteria, kept):
    assert np.flatnonzero(select_times(TIMES, LSTS, Selection(**criteria))).tolist() == kept


@pytest.mark.parametrize(
    ("criteria", "message"),
    [
        ({"time_range": (1.0, 2.0)}, r"\[data\] time_range: leaves no times \(they span JD 2459866.00000"),
        ({"lst_range": (5 * HOUR, 6 * HOUR)}, r"\[data\] lst_range: leaves no times"),
        ({"every_time": 0}, r"\[data\] every_time: must be at least 1"),
    ],
)
def test_no_times(criteria, message):
    with pytest.raises(InputError, match=message):
        select_times(TIMES, LSTS, Selection(**criteria))


@pytest.mark.parametrize(
    ("rule", "held"),
    [
        (HoldoutRule(), [1, 3, 5, 7, 9]),
        (HoldoutRule("times", every=3), [2, 5, 8]),
        (HoldoutRule("lst", lst_ranges=((23.9 * HOUR, 0.1 * HOUR), (1.4 * HOUR, 2.1 * HOUR))), [4, 7, 8]),
        (HoldoutRule("jd", jd_ranges=((TIMES[6], TIMES[9]),)), [6, 7, 8, 9]),
    ],
)
def test_held_out_times(obs, rule, held):
    split = split_holdout(obs, rule)
    assert np.flatnonzero(split.test_times).tolist() == held
    np.testing.assert_array_equal(split.train_times, ~split.test_times)
    assert split.train_bls.all()
    assert split.test_bls.all()


def test_held_out_baselines(obs):
    split = split_holdout(obs, HoldoutRule("baselines", antpairs=((1, 0), (5, 1))))
    assert split.test_bls.tolist() == [True, False, False, True]
    np.testing.assert_array_equal(split.train_bls, ~split.test_bls)
    assert split.train_times.all()
    assert split.test_times.all()


def test_nothing_held_out_on_request(obs):
    split = split_holdout(obs, HoldoutRule("none"))
    assert split.train_times.all()
    assert split.train_bls.all()
    assert not split.test_times.any()
    assert not split.test_bls.any()


@pytest.mark.parametrize(
    ("rule", "message"),
    [
        (HoldoutRule("times", every=11), "holds out nothing"),
        (HoldoutRule("times", every=1), "must be at least 2"),
        (HoldoutRule("lst", lst_ranges=((5.0, 5.5),)), "holds out nothing"),
        (HoldoutRule("lst", lst_ranges=((0.0, 2 * np.pi),)), "leaves nothing to fit"),
        (HoldoutRule("baselines", antpairs=((3, 4),)), "holds out nothing"),
    ],
)
def test_rules_that_split_nothing(obs, rule, message):
    with pytest.raises(InputError, match=message):
        split_holdout(obs, rule)
