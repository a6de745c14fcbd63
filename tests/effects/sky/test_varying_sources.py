"""Missing sources that vary: what their light curves mean, and where these are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.registry import make_effect
from hydrabeam_mpi.effects.shared.time_laws import Smooth
from hydrabeam_mpi.effects.sky.missing_sources import candidates
from hydrabeam_mpi.effects.sky.varying_sources import VaryingSources
from hydrabeam_mpi.random import generator
from tests.effects.cases import experiment_of
from tests.effects.small import small_block

X: FloatArray = np.array([8.0, 6.0, 0.4, -0.3, 0.25, 5.0, 0.0, 0.0, 0.1, 0.0])
"""Level and drift of two sources, Jy, and their offsets and changes of spectral index."""


@pytest.fixture(scope="module")
def setup() -> ObservingSetup:
    return experiment_of((131e6, 151e6), 8, 60)


def two_sources(setup: ObservingSetup, **law: object) -> VaryingSources:
    ra, dec = candidates(setup, np.deg2rad(70.0))
    places = np.rad2deg([[ra[3], dec[3]], [ra[-3], dec[-3]]]).tolist()
    span = {"span": setup.observation.times[[0, -1]].tolist()}
    effect = make_effect("missing_sources", {"sources": places, "law": "smooth", "orders": [0, 1], **span, **law})
    assert isinstance(effect, VaryingSources)
    return effect


def test_at_each_time_they_are_sources_of_the_flux_that_they_have_then(setup: ObservingSetup) -> None:
    effect, block = two_sources(setup), small_block(setup)
    added = effect.added(block, X)
    for t, share in enumerate(Smooth(orders=(1,)).over(setup.observation.times).functions(setup.observation.times)):
        now = np.array([8.0 + 6.0 * share[0], *X[2:5], *X[5:6], *X[7:]])
        expected = effect.effect.added(block.at_time(t), now)[0]
        np.testing.assert_allclose(added[t], expected, rtol=0, atol=1e-12 * np.abs(added).max())
    assert 8.0 + 6.0 * share[0] == pytest.approx(11.0)


def test_the_level_is_looked_for_with_what_varies(setup: ObservingSetup) -> None:
    """As many candidates as without a law, each with the sums of the level and of what varies."""
    block = small_block(setup)
    truth = two_sources(setup)
    found = replace(block, residual=truth.added(block, X), weights=np.ones(block.shape))
    search, constant = (make_effect("missing_sources", {"law": law}) for law in ("smooth", "constant"))
    sums, powers = search.scan(found)  # type: ignore[attr-defined]
    assert sums.shape == powers.shape == (len(candidates(setup)[0]), 3)
    for one, other in zip((sums, powers), constant.scan(found), strict=True):  # type: ignore[attr-defined]
        np.testing.assert_allclose(one[:, :1], other)
    best = np.argsort(-np.sum(sums**2 / powers.clip(1e-9 * powers.max()), axis=1))
    names = search.at(setup, best).parameters(setup).names  # type: ignore[attr-defined]
    assert [name.split(": ")[1] for name in names[:4]] == [
        "flux, level",
        "flux, drift from first to last time",
        "flux, curvature, ends less middle",
        "offset east",
    ]


def test_described_from_where_they_are_they_are_the_same(setup: ObservingSetup) -> None:
    """And told by right ascension, declination and index, as sources without a law are, with a flux a function."""
    effect, block = two_sources(setup), small_block(setup)
    x, std = np.tile(X, (2, 1)), np.tile(0.01 * np.arange(1.0, 11.0), (2, 1))
    refined, left, numbers = effect.refined(x, np.arange(10))
    assert numbers.tolist() == list(range(10))
    np.testing.assert_array_equal(left[:, [0, 1, 4, 5, 6, 9]], x[:, [0, 1, 4, 5, 6, 9]])
    assert not left[:, [2, 3, 7, 8]].any()
    expected = effect.added(block, X)
    np.testing.assert_allclose(refined.added(block, left[0]), expected, atol=1e-9 * np.abs(expected).max())
    only, its, which = effect.refined(x, np.array([5, 6]))
    assert only.effect.sources == refined.effect.sources[1:]
    assert which.tolist() == [5, 6, 7, 8, 9]
    np.testing.assert_array_equal(its, left[:, 5:])
    without_law = [0, 2, 3, 4, 5, 7, 8, 9]
    told = effect.told(setup, x, std)
    of_constant = effect.effect.told(setup, x[:, without_law], std[:, without_law])
    assert [name.split(": ")[1] for name in told.names[:3]] == [
        "flux, level",
        "flux, drift from first to last time",
        "right ascension",
    ]
    np.testing.assert_array_equal(told.values[:, [2, 3, 4, 7, 8, 9]], of_constant.values[:, [1, 2, 3, 5, 6, 7]])
    np.testing.assert_array_equal(told.values[:, [0, 1, 5, 6]], x[:, [0, 1, 5, 6]])
    np.testing.assert_array_equal(told.std[:, [0, 1, 5, 6]], std[:, [0, 1, 5, 6]])
    assert told.units[:3] == ("Jy", "Jy", "deg")
    assert told.from_zero.tolist() == [True, True, False, False, False] * 2


def test_none_has_a_flux_below_zero_at_any_time(setup: ObservingSetup) -> None:
    effect = two_sources(setup)
    x, std = np.tile(X, (2, 1)), np.full((2, 10), 0.1)
    assert not effect.beyond(setup, x, std).any()
    x[:, 1] = 20.0  # from -2 Jy to 18 Jy
    beyond = effect.beyond(setup, x, std)
    np.testing.assert_allclose(beyond, [2.0 / np.hypot(0.1, 0.05)] * 5 + [0.0] * 5)
    left, numbers = effect.without(beyond > 3)
    assert left.effect.sources == effect.effect.sources[1:]
    assert numbers.tolist() == [5, 6, 7, 8, 9]


def test_what_is_drawn_to_simulate_with_varies_and_is_never_dark(setup: ObservingSetup) -> None:
    drawn = make_effect("missing_sources", {"law": "smooth"}).drawn(setup, generator(2, "drawn"))
    x = drawn.draw(setup, generator(3, "draw"), 5.0)
    assert x[0] == 5.0
    assert np.all(x[1:3] != 0)
    assert not drawn.beyond(setup, np.tile(x, (2, 1)), np.full((2, len(x)), 1e-3)).any()


def test_at_other_times_they_have_their_level(setup: ObservingSetup) -> None:
    effect = two_sources(setup)
    assert isinstance(effect.carried_over(setup), VaryingSources)
    observation = replace(setup.observation, times=setup.observation.times + 3.0)
    later = replace(setup, observation=observation)
    here = effect.carried_over(later)
    assert here is effect.effect
    known = here.known_as(here.parameters(later).names)
    names = effect.parameters(setup).names
    assert [name for name in names if name not in known] == [names[1], names[6]]
    assert [known[name][0] for name in names if name in known] == list(range(8))


def test_in_other_nights_they_may_be_as_bright_as_in_those_that_are_known() -> None:
    two_nights = experiment_of((131e6, 151e6), 5, 60, 2)
    effect = two_sources(two_nights, law="nightly", orders=[0, 0], nights=[0, 1])
    later = replace(
        two_nights, observation=replace(two_nights.observation, times=two_nights.observation.times + 4 * 0.99726957)
    )
    assert isinstance(effect.carried_over(later), str)
    found = effect.anew(later)
    assert found is not None
    here, sizes = found
    assert isinstance(here, Effect)
    names, before = here.parameters(later).names, effect.parameters(two_nights).names
    assert set(names) <= set(sizes)
    assert sizes[names[0]] == {before[0]: 0.5, before[1]: 0.5}
    assert sizes[names[2]] == {names[2]: 1.0}


def test_what_does_not_change_of_them_is_sources_with_their_level(setup: ObservingSetup) -> None:
    effect, block = two_sources(setup), small_block(setup)
    found = effect.unchanging(len(X))
    assert found is not None
    constant, numbers = found
    assert constant is effect.effect
    assert len(numbers) == len(constant.parameters(setup))
    steady = np.where(np.isin(np.arange(len(X)), numbers), X, 0.0)
    added = effect.added(block, steady)
    np.testing.assert_allclose(constant.added(block, X[numbers]), added, rtol=0, atol=1e-12 * np.abs(added).max())
    assert two_sources(setup, orders=[1, 2]).unchanging(len(X)) is None
    two_nights = experiment_of((131e6, 151e6), 5, 60, 2)
    assert two_sources(two_nights, law="nightly", orders=[0, 0], nights=[0, 1]).unchanging(len(X)) is None
