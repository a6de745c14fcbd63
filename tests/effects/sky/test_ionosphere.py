from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.registry import make_effect
from hydrabeam_mpi.effects.shared.shifted import ShiftedPositions
from hydrabeam_mpi.effects.shared.time_laws import Smooth
from hydrabeam_mpi.effects.sky.ionosphere import PATHS, Away, Ionosphere
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.state import Active, Values
from hydrabeam_mpi.loop.selection.refits import rise, with_best_variant
from tests.effects.direct import assert_same, of_direction, visibilities
from tests.effects.small import small_block, small_setup, with_effect
from tests.loop.mock import context_of, mock_job


@pytest.mark.parametrize("towards", [0, 1])
def test_visibilities_are_those_of_a_sky_that_is_turned(towards: int) -> None:
    """Plane trigonometry in the vertical plane of the shift, which goes as the wavelength squared."""
    setup = small_setup()
    arcmin = 10.0 + np.arange(6)
    x = np.zeros((6, 2))
    x[:, towards] = arcmin
    for channel, freq in enumerate((131e6, 151e6)):
        block = small_block(setup, channel)
        effect = Ionosphere()
        block.integrate_for([effect])

        def shift(directions: FloatArray, itime: int, freq: float = freq) -> FloatArray:
            angle = np.deg2rad(arcmin[itime] / 60) * (141e6 / freq) ** 2
            shifted = directions.copy()
            shifted[towards] = np.cos(angle) * directions[towards] + np.sin(angle) * directions[2]
            shifted[2] = np.cos(angle) * directions[2] - np.sin(angle) * directions[towards]
            return shifted

        assert_same(with_effect(effect, block, x.ravel()), visibilities(block, turn=shift), block)


@pytest.mark.parametrize("away", ["flat", "shell"])
def test_visibilities_are_those_of_shifted_direction_cosines(away: Away) -> None:
    """A phase that is a gradient over the array, or that and the longer way through a shell 350 km up."""
    setup = small_setup()
    x = np.array([[10.0, -4.0]] * 6) * np.arange(1, 7)[:, np.newaxis]
    block = small_block(setup, 1)
    effect = Ionosphere(away)
    block.integrate_for([effect])

    def shift(directions: FloatArray, itime: int) -> FloatArray:
        longer = 1.0
        if away == "shell":
            # The angle at which the line of sight meets the shell, by the law of sines.
            met = np.arcsin(np.sin(np.arccos(directions[2])) * 6371 / (6371 + 350))
            longer = 1 / np.cos(met)
        east, north = directions[:2] + longer * np.deg2rad(x[itime] / 60)[:, np.newaxis] * (141 / 151) ** 2
        left = 1 - east**2 - north**2
        return np.stack([east, north, np.where(left > 0, np.sqrt(np.maximum(left, 0)), -1.0)])

    def beam(directions: FloatArray, row: int) -> FloatArray:
        return np.where(directions[2] > 0, of_direction(block)(directions), 0.0)

    assert_same(with_effect(effect, block, x.ravel()), visibilities(block, turn=shift, beam=beam), block)


def test_what_is_shifted_below_the_horizon_is_not_seen() -> None:
    positions = small_block(small_setup()).positions
    path = PATHS["flat"]
    still, far = (ShiftedPositions(positions, {0: np.array([shift, 0.0])}, path) for shift in (0.0, 1.9))
    index, za, _ = positions.above_horizon(0)
    np.testing.assert_array_equal(still.above_horizon(0)[0], index)
    np.testing.assert_allclose(still.above_horizon(0)[1], za, atol=1e-7)
    assert len(far.above_horizon(0)[0]) < len(index)


def test_the_fit_tells_what_shifts_are_away_from_the_zenith(tmp_path: Path) -> None:
    """By the likelihood: all have the same parameters."""
    assert [one.describe()["away"] for one in Ionosphere("flat").variants(small_setup())] == ["turn", "shell"]
    refracted = {"kind": "ionosphere", "settings": {"away": "shell"}, "strength": 3.0}
    context = context_of(mock_job(refracted), tmp_path)
    before = refit(context, Values())
    n = len(Ionosphere().parameters(context.setup))
    start = Active.start(Ionosphere(), context.setup, np.full(n, 9.0), np.zeros((1, n)))
    turned = refit(context, before.values.extended(start), before)
    found = with_best_variant(context, turned)
    assert found.values.active[0].effect.describe() == {"away": "shell"}
    assert with_best_variant(context, found) is found
    assert rise(context, turned, found) > 5
    assert Ionosphere().next_after(context.setup, Ionosphere("shell")).describe() == {"away": "shell"}


def test_times_are_told_apart_in_any_order() -> None:
    setup = replace(small_setup(), times=np.array([4, 0, 2]))
    block = replace(small_block(setup), times=np.array([0, 4]))
    effect = Ionosphere()
    block.integrate_for([effect])
    columns = effect.columns(block, np.zeros(6))
    assert columns.n_params == 6
    assert columns.index is not None
    assert columns.index[:, 0].tolist() == [[2, 3], [0, 1]]
    names = effect.parameters(setup).names
    assert names[0].endswith(f"{setup.observation.times[4]:.5f}")
    change = effect.added(block, np.array([0.0, 0.0, 1.0, 0.0, 5.0, 0.0]))
    assert change[0].all()
    assert not change[1].any()


@pytest.mark.parametrize("away", get_args(Away))
def test_what_drifts_is_what_it_is_at_each_time(away: Away) -> None:
    """Level, drift and curvature of both shifts, as so many of each time."""
    setup = small_setup(n_times=5)
    law = Smooth(orders=(0, 1, 2)).over(setup.jd)
    drifting = Ionosphere(away).changing(law)
    x = np.array([3.0, 1.0, -0.5, -2.0, 0.5, 1.5])
    block = small_block(setup)
    block.integrate_for([drifting])
    shifts = law.functions(setup.jd) @ x.reshape(2, 3).T
    anew = Ionosphere(away)
    np.testing.assert_allclose(drifting.added(block, x), anew.added(block, shifts.ravel()), rtol=0, atol=1e-9)
    columns, of_times = drifting.columns(block, x), anew.columns(block, shifts.ravel())
    step = np.array([0.0, 1.0, 0.0, 1.0, 0.0, 0.0])
    moved = (law.functions(setup.jd) @ step.reshape(2, 3).T).ravel()
    np.testing.assert_allclose(columns.apply(step), of_times.apply(moved), rtol=1e-9)
    assert drifting.local is None
    assert drifting.describe()["away"] == away
    others = [one for one in get_args(Away) if one != away]
    assert [one.describe()["away"] for one in drifting.variants(setup)] == others
    assert drifting.next_after(setup, drifting.variants(setup)[0]).describe()["away"] != away
    assert make_effect("ionosphere", drifting.describe()).describe() == drifting.describe()
