"""Laws in data of several nights: what a night is, what repeats and what begins anew."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from hydrabeam_mpi.data.observation import SIDEREAL_DAY, FloatArray
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.registry import laws_of, make_effect
from hydrabeam_mpi.effects.shared.in_time import InTime
from hydrabeam_mpi.effects.shared.nightly_laws import Nightly, Sidereal
from hydrabeam_mpi.effects.shared.time_laws import Piecewise, Smooth
from tests.effects.cases import experiment_of
from tests.effects.small import small_block

HOURS = 2459866.7 + np.linspace(0.0, 0.2, 21)


def nights(*numbers: int, shift: float = 0.0) -> FloatArray:
    """Return times of nights, each a little earlier in sidereal time than the one before."""
    return np.concatenate([HOURS + number * (SIDEREAL_DAY + shift) for number in numbers])


def test_nights_part_where_there_are_no_data() -> None:
    for turned in (0.0, 0.4, 0.9):
        times = nights(0, 1, 4, shift=-1e-3) + turned
        law = Sidereal().over(times)
        np.testing.assert_array_equal(law.nights_of(times), np.repeat([0, 1, 4], 21))
        assert law.hours == pytest.approx((times[0] - 4e-3, times[20]), abs=1e-6)


def test_what_is_sidereal_is_known_in_other_nights() -> None:
    times = nights(0, 1)
    law = replace(Sidereal().over(times), orders=(1, 3))
    here = law.functions(times)
    np.testing.assert_allclose(here[:21], here[21:], atol=1e-6)
    np.testing.assert_allclose(law.functions(nights(7)), here[:21], atol=1e-5)
    assert law.covers(nights(7))
    assert law.covers(nights(7) - 0.08)
    assert not law.covers(nights(7) - 0.12)
    np.testing.assert_allclose(law.functions(times[:1] - 0.3), here[:1], atol=1e-6)


def test_what_is_of_single_nights_is_not() -> None:
    times = nights(0, 1, 2)
    law = Nightly().over(times).candidates(times[::2], times)
    assert law.names()[:4] == [
        "night 2: level",
        "night 3: level",
        "night 1: drift from first to last time",
        "night 2: drift from first to last time",
    ]
    of_night = [np.flatnonzero(part.any(axis=0)) for part in np.split(law.functions(times), 3)]
    assert all(not np.intersect1d(one, two).size for one, two in pairwise(of_night))
    assert law.covers(times)
    assert not law.functions(nights(4)).any()
    assert not law.covers(nights(4))


def test_one_law_over_all_nights_has_no_swing_within_one() -> None:
    for n in (2, 3):
        times = nights(*range(n))
        assert Smooth().over(times).candidates(times, times).orders == tuple(range(1, n))
        assert len(Sidereal().over(times).candidates(times, times).orders) == 10
    assert Smooth().over(HOURS).candidates(HOURS[::2], HOURS).orders == (1, 2, 3, 4, 5)


def test_they_need_several_nights() -> None:
    two, one = experiment_of((131e6,), 5, 60, 2), experiment_of((131e6,), 8, 60)
    for effect in laws_of("antenna_gains"):
        assert effect.not_applicable(two) is None
        assert (effect.not_applicable(one) is None) == (effect.law not in ("sidereal", "nightly"))
        # One that is fitted is enough where it is alike in the others.
        first = effect.not_applicable(replace(two, fitted=np.arange(5)))
        assert (first is None) == (effect.law != "nightly")


@pytest.mark.parametrize(
    ("law", "names"),
    [
        (Smooth(orders=(1,)), {"level": ["drift from first to last time"], "drift from first to last time": 1}),
        (Piecewise(jumps=(1.0, 2.0)), {"jump at JD 2459867.69726": ["jump at JD 1.00000", "jump at JD 2.00000"]}),
        (Nightly(orders=(0, 1, 1), nights=(1, 0, 1)), {"night 1: level": ["night 2: level"]}),
        (Sidereal(orders=(2,)), {"curvature, ends less middle": 1}),
    ],
)
def test_in_other_nights_it_may_be_as_large(law: Smooth, names: dict[str, list[str]]) -> None:
    found, alike = law.over(HOURS).anew(nights(1))  # type: ignore[misc]
    before = law.names()
    sizes = {name: [before[i] for i in numbers] for name, numbers in zip(found.names(), alike, strict=True)}
    for name, others in names.items():
        assert sizes[name] == (others if isinstance(others, list) else [name])
    assert found.functions(nights(1)).any(axis=0).all()
    assert found.covers(nights(1))


def test_a_baseline_has_the_size_that_it_had_in_either_sense() -> None:
    setup = experiment_of((131e6,), 5, 60, 2)
    one, two = setup.observation.antenna_numbers[setup.antenna_index][4].tolist()
    law = {"law": "nightly", "orders": [1, 1], "nights": [0, 1], "baselines": [[two, one]]}
    effect = make_effect("cross_coupling", law)
    assert isinstance(effect, InTime)
    found = effect.anew(setup)
    assert found is not None
    here, sizes = found
    assert isinstance(here, Effect)
    parameters = here.parameters(setup)
    assert set(sizes) == set(parameters.names)
    drift = "drift from first to last time"
    told = sizes[f"baseline {one}-{two} real, night 2: {drift}"]
    assert told == {
        f"baseline {a}-{b} real, night {n}: {drift}": 0.5 for a, b in ((one, two), (two, one)) for n in (1, 2)
    }
    assert here.columns(small_block(setup), np.zeros(4)).n_params == 4
