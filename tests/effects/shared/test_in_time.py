"""Laws in time: what their numbers mean, which functions are picked, and where a law is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.registry import make_effect
from hydrabeam_mpi.effects.shared.anew_law import Anew
from hydrabeam_mpi.effects.shared.in_time import InTime
from hydrabeam_mpi.effects.shared.time_laws import SECOND, Piecewise, Smooth
from hydrabeam_mpi.effects.sky.catalogue_flux import CatalogueFlux
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.random import generator
from tests.effects.cases import experiment_of
from tests.effects.small import small_block, with_effect

TIMES = np.linspace(2459866.6, 2459866.9, 31)


@pytest.fixture(scope="module")
def setup() -> ObservingSetup:
    return experiment_of((131e6,), 8, 60)


def changing(kind: str, setup: ObservingSetup, **law: object) -> Effect:
    return make_effect(kind, {"span": setup.observation.times[[0, -1]].tolist(), **law})


def test_numbers_of_smooth_laws_are_changes() -> None:
    drift, curvature, third = Smooth(orders=(1, 2, 3)).over(TIMES).functions(TIMES).T
    assert drift[-1] - drift[0] == pytest.approx(1)
    assert np.mean([curvature[0], curvature[-1]]) - curvature[15] == pytest.approx(1)
    assert np.ptp(third) == pytest.approx(1, abs=0.02)
    np.testing.assert_allclose(np.diff(drift), 1 / 30)


def test_a_law_does_not_go_on_beyond_the_times_in_which_it_was_found() -> None:
    law = Smooth(orders=(1, 4)).over(TIMES)
    assert law.covers(TIMES[3:])
    assert not law.covers(TIMES + 1)
    assert not Smooth(orders=(1,)).covers(TIMES)
    np.testing.assert_array_equal(law.functions(TIMES + 1), np.tile(law.functions(TIMES)[-1], (31, 1)))


def test_what_is_anew_at_each_time_has_a_number_for_each() -> None:
    law = Anew().candidates(TIMES[::3], TIMES)
    np.testing.assert_array_equal(law.functions(TIMES), np.eye(len(TIMES)))
    # A file may round its times, and other data have other ones.
    np.testing.assert_array_equal(law.functions(TIMES + 0.3 * SECOND), np.eye(len(TIMES)))
    assert not law.functions(TIMES + 2 * SECOND).any()
    assert law.first(3) == law
    assert law.at([2, 0]).names() == [f"at JD {TIMES[0]:.5f}", f"at JD {TIMES[2]:.5f}"]
    assert law.not_applicable(TIMES[::2], TIMES) is None
    assert "600 at most" in str(law.not_applicable(TIMES, np.arange(601.0)))


def test_how_large_it_is_all_its_times_have_in_common(setup: ObservingSetup) -> None:
    sources = CatalogueFlux().foremost(setup, 2).sources
    effect = changing("catalogue_flux", setup, law="anew", times=setup.observation.times.tolist(), sources=sources)
    assert effect.parameters(setup).element.tolist() == [0] * 8 + [1] * 8
    assert effect.local == "times"
    x = np.zeros(16)
    x[3] = 0.5
    block = small_block(setup)
    changed = np.abs(with_effect(effect, block, x) - block.vis).max(axis=1)
    assert np.flatnonzero(changed).tolist() == [3]


def test_jumps_are_looked_for_between_fitted_times_and_may_be_elsewhere_between_these() -> None:
    fitted = TIMES[::3]
    every = Piecewise().candidates(fitted, TIMES)
    # Two times at least are on either side: one alone is no level.
    assert every.functions(fitted).sum(axis=0).tolist() == list(range(len(fitted) - 2, 1, -1))
    law = every.at([1])
    steps = law.functions(fitted)[:, 0]
    np.testing.assert_array_equal(steps, np.arange(len(fitted)) >= 3)
    others = law.alternatives(0, fitted, TIMES)
    assert [int(one.functions(TIMES).sum()) for one in (*others, law)] == [24, 23, 22]
    assert all(np.array_equal(one.functions(fitted)[:, 0], steps) for one in others)
    assert not Piecewise(jumps=law.jumps).alternatives(0, TIMES, TIMES)


def test_of_neighbouring_jumps_one_is_weighed() -> None:
    assert Piecewise().best(np.array([5, 6, 4, 9, 8, 1, 0, 13, 20]), 4).tolist() == [5, 9, 1, 13]


def test_the_functions_that_explain_most_are_picked(setup: ObservingSetup) -> None:
    block = small_block(setup)
    jump = float(setup.observation.times[3:5].mean())
    for law, wanted in (({"law": "smooth", "orders": [3]}, "order 3"), ({"law": "piecewise", "jumps": [jump]}, "jump")):
        effect = changing("antenna_gains", setup, **law)
        x = np.zeros(len(effect.parameters(setup)))
        x[4] = 0.01
        found = replace(block, residual=with_effect(effect, block, x) - block.vis, weights=np.ones(block.shape))
        search = make_effect("antenna_gains", {"law": law["law"]})
        assert isinstance(search, InTime)
        best = np.argsort(-np.sum(search.scan(found)[0] ** 2 / search.scan(found)[1].clip(1e-300), axis=1))
        (name,) = search.at(setup, best[:1]).time_law.names()
        assert wanted in name
        assert search.at(setup, best[:1]).describe() == effect.describe()


def test_what_all_antennas_have_in_common_is_a_number_of_its_own(setup: ObservingSetup) -> None:
    block = small_block(setup)
    effect = changing("antenna_gains", setup, law="smooth", orders=[1, 2])
    names = effect.parameters(setup).names
    common, each = (
        np.array([name.startswith(who) and "amplitude, drift" in name for name in names]) for who in ("all", "antenna")
    )
    assert (common.sum(), each.sum()) == (1, 7)
    np.testing.assert_allclose(effect.factor(block, 0.1 * common), effect.factor(block, 0.1 * each), rtol=1e-14)
    assert np.ptp(np.abs(effect.factor(block, 0.1 * common))[:, 0]) > 0.1


def test_the_level_of_all_gains_is_told_from_no_beam(setup: ObservingSetup) -> None:
    """As a constant it would go to infinity where the beam's prior has no width, and the beam to zero."""
    effect = changing("antenna_gains", setup, law="smooth", orders=[0, 1])
    held, names = effect.degenerate_directions(setup), effect.parameters(setup).names
    block = small_block(setup)
    factors = np.array([effect.factor(block, 0.1 * one) for one in held])
    np.testing.assert_allclose(factors, np.broadcast_to(factors[:, :1, :1], factors.shape), atol=1e-12)
    # Phases that drift together, and of what is constant phases, amplitudes, and these once more as a number.
    assert np.linalg.matrix_rank(held) == len(held) == 4
    (common,) = np.flatnonzero((held != 0).sum(axis=1) == 1)
    assert names[np.argmax(held[common])] == "all antennas ln amplitude, level"
    assert not held[:, names.index("all antennas ln amplitude, drift from first to last time")].any()


def test_a_fit_of_a_sign_that_is_lost_for_some_time_begins_with_jumps_of_the_phase(setup: ObservingSetup) -> None:
    """And what is zero, as it is not in use, stays so."""
    times = setup.observation.times
    there, back = float(times[2:4].mean()), float(times[5:7].mean())
    effect = changing("antenna_gains", setup, law="piecewise", jumps=[there, back])
    x = np.zeros((1, len(effect.parameters(setup))))
    x[0, 4:8] = -2.0, 2.0, 1e-12, 1e-12  # ln amplitude of the second antenna, and its phase
    begun = effect.begun(setup, x)
    np.testing.assert_allclose(begun[0, 4:8], [0.0, 0.0, np.pi, -np.pi], atol=1e-9)
    assert not np.delete(begun, np.s_[4:8]).any()
    assert not effect.needed_at(setup, x)[2].any()
    # Where no phase was looked for it is needed.
    x[0, 6:8] = 0.0
    np.testing.assert_array_equal(np.flatnonzero(effect.needed_at(setup, x)[2]), [6, 7])
    np.testing.assert_allclose(effect.begun(setup, x), begun, atol=1e-9)


def test_a_jump_shows_by_what_is_near_it(setup: ObservingSetup) -> None:
    """What comes and goes again shows where it goes as well, and of all jumps at these two most."""
    times = np.arange(30.0)
    fitted = times[::2]
    law = Piecewise().over(times).candidates(fitted, times)
    functions, number = law.scanned(fitted, times)
    assert functions.shape == (30, len(number))
    signal = np.where((times >= 10) & (times < 19), 1.0, 0.0)[::2]
    score = functions[::2].T @ signal
    drop = score**2 / np.maximum(np.sum(functions[::2] ** 2, axis=0), 1.0)
    best = law.best(number[np.argsort(-drop, kind="stable")], 3)
    assert {law.jumps[one] for one in best} > {9.5, 19.5}
    # Times that are not fitted tell nothing.
    assert not functions[1::2, len(law.jumps) :].any()


def test_jumps_that_values_want(setup: ObservingSetup) -> None:
    """As many as tell them; what is not known counts as little as it is known."""
    times, std = np.arange(20.0), np.full(20, 0.1)
    law = Piecewise().over(times).candidates(times, times).with_level()
    noise = 0.1 * generator(3, "values").standard_normal(20)
    values = np.where(times < 8, 2.0, -1.0)
    assert {law.jumps[one] for one in law.wanted_by(times, values + noise, std)} == {-SECOND, 7.5}
    assert law.wanted_by(times, noise, std) == []
    values[17:] = 0.0
    std[17:] = 1e3
    assert {law.jumps[one] for one in law.wanted_by(times, values, std)} == {-SECOND, 7.5}


def test_tilts_at_a_time_are_those_of_an_antenna_that_is_tilted_so(setup: ObservingSetup) -> None:
    """By degrees, where what they change is not linear; and so are the columns."""
    block = small_block(setup)
    drifting = changing("antenna_pointing", setup, law="smooth", orders=[1, 2])
    constant = make_effect("antenna_pointing", {})
    block.integrate_for([drifting])
    names, n = drifting.parameters(setup).names, len(constant.parameters(setup))
    x = np.zeros(len(names))
    x[[4, 5, 6, 9]] = 3.0, 1.0, -2.0, 1.5
    common = names.index("all antennas tilted towards North, drift from first to last time")
    x[common] = 2.0
    added, columns = drifting.added(block, x), drifting.columns(block, x).matrix().toarray().reshape(*block.shape, -1)
    functions = Smooth(orders=(1, 2)).over(setup.observation.times).functions(setup.observation.times)
    for t, phi in enumerate(functions):
        now = x.reshape(-1, 2) @ phi
        tilts = now[:n] + np.tile([0.0, phi[0] * 2.0], n // 2)
        one = block.at_time(t)
        np.testing.assert_allclose(added[t], constant.added(one, tilts)[0], rtol=1e-12)
        own = constant.columns(one, tilts).matrix().toarray()
        np.testing.assert_allclose(columns[t][:, 0 : 2 * n : 2], own * phi[0], rtol=1e-9, atol=1e-15)
        np.testing.assert_allclose(columns[t][:, common], own[:, 1::2].sum(axis=1) * phi[0], rtol=1e-9, atol=1e-14)


def test_a_source_fades_and_the_others_do_not(setup: ObservingSetup) -> None:
    block = small_block(setup)
    place = np.rad2deg([setup.sky.ra[0], setup.sky.dec[0]]).tolist()
    fading = changing("catalogue_flux", setup, law="smooth", orders=[1], sources=[place])
    for itime in (0, 7):
        sources = block.sources(itime)
        expected = np.where(sources.index == 0, 1.4 if itime else 0.6, 1.0)
        np.testing.assert_allclose(fading.sky_factor(setup, sources, np.array([0.8])), expected)


def test_it_needs_several_fitted_times(setup: ObservingSetup) -> None:
    smooth, piecewise = (make_effect("antenna_gains", {"law": law}) for law in ("smooth", "piecewise"))
    few = replace(setup, fitted=np.arange(3))
    for effect in (smooth, piecewise):
        assert effect.not_applicable(setup) is None
        assert "4 fitted times or more; there are 3" in str(effect.not_applicable(few))


@pytest.mark.parametrize(
    ("kind", "law"),
    [
        ("antenna_gains", "linear"),
        ("cross_coupling", "piecewise"),
        ("orientation", "smooth"),
        ("antenna_pointing", "nightly"),
        ("antenna_gains", 3),
    ],
)
def test_laws_that_an_effect_does_not_have_are_refused(kind: str, law: object) -> None:
    with pytest.raises(InputError, match=f"no law '{law}' of this effect; there are constant"):
        make_effect(kind, {"law": law})


@pytest.mark.parametrize("settings", [{"orders": [-1]}, {"orders": "a"}, {"span": [1.0]}, {"jumps": [2.0]}])
def test_what_no_law_has_is_refused(settings: dict[str, object]) -> None:
    with pytest.raises(InputError, match="settings: are not understood"):
        make_effect("antenna_gains", {"law": "smooth", **settings})


def test_no_source_varies_to_a_flux_below_zero(setup: ObservingSetup) -> None:
    """At no time; numbers that are not in use are not counted, and the other sources stay."""
    places = np.rad2deg([setup.sky.ra[:3], setup.sky.dec[:3]]).T.tolist()
    effect = changing("catalogue_flux", setup, law="smooth", orders=[1, 2], sources=places)
    functions = Smooth(orders=(1, 2)).over(setup.observation.times).functions(setup.observation.times[setup.times])
    x = np.tile([1.5, 0.4, 3.0, 0.0, -772.0, 1825.0], (len(setup.observation.freqs), 1))
    std = np.tile([0.1, 0.1, 0.1, 0.0, 1.0, 1.0], (len(x), 1))
    beyond = effect.beyond(setup, x, std)
    low = -1 - 3.0 * functions[:, 0]
    assert beyond[2] == pytest.approx(np.max(low / np.abs(0.1 * functions[:, 0])))
    np.testing.assert_array_equal(beyond > 3, [False, False, True, False, True, True])
    left, numbers = effect.without(beyond > 3)
    assert numbers.tolist() == [0, 1]
    assert left.parameters(setup).names == effect.parameters(setup).names[:2]
    assert left.law == "smooth"
