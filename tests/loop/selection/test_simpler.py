"""Elements of an effect become what has fewer parameters where that is likelier, and keep their place where not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hydrabeam_mpi.effects.instrument.antenna_delays import AntennaDelays
from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.instrument.antenna_positions import AntennaPositions
from hydrabeam_mpi.effects.instrument.array_scale import ArrayScale
from hydrabeam_mpi.effects.instrument.cable_reflections import CableReflections
from hydrabeam_mpi.effects.instrument.gain_jitter import GainJitter
from hydrabeam_mpi.effects.instrument.orientation import Orientation
from hydrabeam_mpi.effects.instrument.timestamp import Timestamp
from hydrabeam_mpi.effects.shared.anew_law import Anew
from hydrabeam_mpi.effects.shared.in_time import InTime
from hydrabeam_mpi.effects.shared.time_laws import Piecewise, Smooth
from hydrabeam_mpi.effects.sky.catalogue_flux import CatalogueFlux
from hydrabeam_mpi.effects.sky.elongated_source import ElongatedSource
from hydrabeam_mpi.effects.sky.missing_sources import MissingSources
from hydrabeam_mpi.effects.sky.moving_sources import MovingSources
from hydrabeam_mpi.effects.sky.resolved_source import ResolvedSource
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.state import Active, Values
from hydrabeam_mpi.loop.selection.acceptance import Round
from hydrabeam_mpi.loop.selection.predictions import check
from hydrabeam_mpi.loop.selection.refits import fit_patiently
from hydrabeam_mpi.loop.selection.simpler import simplified
from hydrabeam_mpi.random import generator
from tests.loop.made import effect_candidate, round_of
from tests.loop.mock import context_of, mock_job

GAIN = {"kind": "antenna_gains", "parameters": {"antenna 2 ln amplitude": 0.06, "antenna 2 phase": -0.05}}
GAINS = AntennaGains()
TRIALS = 100


def fitted_as_sources(context: FitContext, *sources: tuple[float, float]) -> Round:
    """A round that has found missing sources at some places."""
    effect = MissingSources(sources, TRIALS)
    n = len(effect.parameters(context.setup))
    var, x = np.zeros(n), np.zeros((1, n))
    var[::3], x[:, ::3] = 100.0, 1.0
    before = check(context, refit(context, Values()))
    after = check(context, refit(context, Values((Active.start(effect, context.setup, var, x),)), before.fitted))
    return round_of(effect_candidate(effect), before, after)


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> FitContext:
    return context_of(mock_job(), tmp_path_factory.mktemp("plain"))


def brightest(context: FitContext) -> tuple[float, float]:
    """The catalogue source that the model beam sees brightest."""
    return CatalogueFlux().foremost(context.setup, 1).sources[0]


def with_wrong_flux(plain: FitContext, folder: Path) -> FitContext:
    """Data in which that has 30% more than in the catalogue, and a source is missing."""
    flux = {"kind": "catalogue_flux", "settings": {"sources": [list(brightest(plain))]}, "strength": 3.0}
    missing = {"kind": "missing_sources", "settings": {"sources": [list(place_of_missing(plain))]}, "strength": 10.0}
    return context_of(mock_job(flux, missing), folder)


def place_of_missing(plain: FitContext) -> tuple[float, float]:
    """A place as high as that of the brightest, and six degrees from it."""
    ra, dec = brightest(plain)
    return (ra + 6.0) % 360, dec


def test_a_source_where_the_catalogue_has_one_is_its_flux(plain: FitContext, tmp_path: Path) -> None:
    """And the one beside it, where the catalogue has none, stays what it is."""
    context = with_wrong_flux(plain, tmp_path)
    ra, dec = brightest(plain)
    found = fitted_as_sources(context, (ra + 0.3, dec - 0.2), place_of_missing(plain))
    assert found.after.score.chi2 == pytest.approx(1, abs=0.1)
    added, places = simplified(context, found.after, [found], [CatalogueFlux()], []) or pytest.fail("nothing was found")
    assert places == {0: 0, 1: 1}
    assert "taken back, as fluxes of catalogue sources explain as much with less" in added.revised[0]
    source, flux = added.after.fitted.values.active
    assert isinstance(source.effect, MissingSources)
    # It has not the other any more, which would be found again.
    assert source.used.tolist() == [0, 1, 2]
    assert source.effect.sources == (place_of_missing(plain),)
    assert isinstance(flux.effect, CatalogueFlux)
    assert flux.effect.sources == (brightest(plain),)
    error, std = flux.x[0, 0], added.after.fitted.fit.std[1][0, 0]
    assert abs(abs(error) - 0.3) < 4 * std < 0.04
    assert added.after.score.chi2 == pytest.approx(1, abs=0.1)
    # Where it is not to be looked for it is not told so.
    assert simplified(context, found.after, [found], [], []) is None


def test_the_effect_is_gone_with_its_last_source(plain: FitContext, tmp_path: Path) -> None:
    flux = {"kind": "catalogue_flux", "settings": {"sources": [list(brightest(plain))]}, "strength": 3.0}
    context = context_of(mock_job(flux), tmp_path)
    ra, dec = brightest(plain)
    found = fitted_as_sources(context, (ra + 0.3, dec - 0.2))
    added, places = simplified(context, found.after, [found], [CatalogueFlux()], []) or pytest.fail("nothing was found")
    assert places == {0: None, 1: 0}
    (flux_of_known,) = added.after.fitted.values.active
    assert isinstance(flux_of_known.effect, CatalogueFlux)


def test_a_source_near_a_known_one_stays_where_it_is(plain: FitContext, tmp_path: Path) -> None:
    """It is told from the other by its place, which differs by many of its standard errors."""
    ra, dec = brightest(plain)
    beside = (ra + 2.0, dec)
    missing = {"kind": "missing_sources", "settings": {"sources": [list(beside)]}, "strength": 10.0}
    context = context_of(mock_job(missing), tmp_path)
    found = fitted_as_sources(context, beside)
    assert simplified(context, found.after, [found], [CatalogueFlux()], []) is None


@pytest.mark.parametrize("moves", [True, False])
def test_a_source_that_was_taken_for_a_moving_one(moves: bool, plain: FitContext, tmp_path: Path) -> None:
    """It is told to stay where it does, as two numbers less are to be told then."""
    place = list(place_of_missing(plain))
    truth: dict[str, object] = {"kind": "missing_sources", "settings": {"sources": [place]}, "strength": 10.0}
    if moves:
        truth = {"kind": "moving_sources", "settings": {"sources": [place], "rates": [[0.2, -0.1]]}, "strength": 10.0}
    context = context_of(mock_job(truth), tmp_path)
    effect = MovingSources([place_of_missing(plain)], 9 * TRIALS).in_full(context.setup)
    start = Active.start(effect, context.setup, np.array([100.0, 0, 0, 0, 0]), np.array([[1.0, 0, 0, 0, 0]]))
    before = check(context, refit(context, Values()))
    after = check(context, refit(context, Values((start,)), before.fitted))
    assert after.score.chi2 == pytest.approx(1, abs=0.1)
    assert effect.price_of_motion(context.setup, after.fitted.values.active[0].x, after.fitted.fit.std[0]) > 2
    found = simplified(context, after, [round_of(effect_candidate(effect), before, after)], [MissingSources()], [])
    assert (found is None) == moves
    if found is not None:
        (stays,) = found[0].after.fitted.values.active
        assert type(stays.effect) is MissingSources
        assert found[1] == {0: None, 1: 0}


@pytest.mark.parametrize("axes_differ", [True, False])
def test_a_source_that_was_taken_for_an_elongated_one(axes_differ: bool, plain: FitContext, tmp_path: Path) -> None:
    """It is told as round where its axes do not differ, as two numbers less are to be told then."""
    place, squares = brightest(plain), np.array([4000.0, 1500.0 * axes_differ, 0.0])
    effect = ElongatedSource([place], TRIALS)
    names = effect.parameters(plain.setup).names
    truth = {"kind": "elongated_source", "settings": {"sources": [list(place)]}}
    context = context_of(mock_job({**truth, "parameters": dict(zip(names, squares.tolist(), strict=True))}), tmp_path)
    start = Active.start(effect, context.setup, np.full(3, 1e7), squares[np.newaxis])
    before = check(context, refit(context, Values()))
    after = check(context, refit(context, Values((start,)), before.fitted))
    assert after.score.chi2 == pytest.approx(1, abs=0.1)
    found = simplified(context, after, [round_of(effect_candidate(effect), before, after)], [ResolvedSource()], [])
    assert (found is None) == axes_differ
    if found is not None:
        (resolved,) = found[0].after.fitted.values.active
        assert type(resolved.effect) is ResolvedSource
        assert abs(resolved.x[0, 0] - 4000.0) < 4 * found[0].after.fitted.fit.std[0][0, 0]
        assert found[1] == {0: None, 1: 0}


@pytest.mark.parametrize(("before", "jumps"), [(2, False), (4, True), (9, True)])
def test_gains_that_were_taken_for_jumping_ones(before: int, jumps: bool, plain: FitContext, tmp_path: Path) -> None:
    """They are told as constant where a jump near the first time only stood for that, and as jumping where they do.

    Where they are zero at most of the twelve times there is nothing constant to try.
    """
    after = 0.5 * plain.setup.observation.times[before - 1 : before + 1].sum()
    effect = InTime(AntennaGains(), Piecewise(jumps=(float(after),))).in_full(plain.setup)
    names = effect.parameters(plain.setup).names
    gain = {
        **GAIN,
        "parameters": {f"{name}, {effect.time_law.names()[0]}": x for name, x in GAIN["parameters"].items()},
    }
    truth = {**gain, "settings": effect.describe()} if jumps else GAIN
    context = context_of(mock_job(truth), tmp_path)
    var = np.where([name.startswith("antenna 2 ") for name in names], 0.01, 0.0)
    first = check(context, refit(context, Values()))
    start = Active.start(effect, context.setup, var, np.zeros((1, len(names))))
    now = check(context, refit(context, Values((start,)), first.fitted))
    found = simplified(context, now, [round_of(effect_candidate(effect), first, now)], [AntennaGains()], [])
    assert (found is None) == jumps
    if found is not None:
        (constant,) = found[0].after.fitted.values.active
        assert constant.effect.law == "constant"
        assert found[0].after.score.chi2 == pytest.approx(1, abs=0.1)


@pytest.mark.parametrize("jitters", [False, True])
def test_gains_that_were_taken_for_jittering_ones(jitters: bool, tmp_path: Path) -> None:
    """They drift where a law has what each time has a number for, and jitter where it has not."""
    gains_of = [(2, "ln amplitude")]
    drift = {
        "kind": "antenna_gains",
        "settings": {"law": "smooth", "orders": [0, 1]},
        "parameters": {
            "antenna 2 ln amplitude, level": 0.02,
            "antenna 2 ln amplitude, drift from first to last time": 0.06,
        },
    }
    jitter = {"kind": "gain_jitter", "settings": {"gains_of": gains_of}, "strength": 3.0}
    context = context_of(mock_job(jitter if jitters else drift, n_times=18), tmp_path)
    effect = GainJitter(gains_of)
    n = len(effect.parameters(context.setup))
    first = check(context, refit(context, Values()))
    start = Active.start(effect, context.setup, np.full(n, 0.01), np.zeros((1, n)))
    now = check(context, refit(context, Values((start,)), first.fitted))
    found = simplified(context, now, [round_of(effect_candidate(effect), first, now)], [AntennaGains()], [])
    assert (found is None) == jitters
    if found is not None:
        (drifting,) = found[0].after.fitted.values.active
        told = dict(zip(drifting.effect.parameters(context.setup).names, drifting.x[0], strict=True))
        in_use = {name: x for name, x in told.items() if x}
        assert in_use == pytest.approx(drift["parameters"], abs=5e-3)
        assert found[0].after.score.chi2 == pytest.approx(1, abs=0.1)


@pytest.mark.parametrize("scintillates", [False, True])
def test_a_source_that_was_taken_for_a_scintillating_one(scintillates: bool, plain: FitContext, tmp_path: Path) -> None:
    """It varies by a law where that says as much with less, and scintillates where it does not."""
    n_times, sources = 18, [list(brightest(plain))]
    times = context_of(mock_job(n_times=n_times), tmp_path / "plain").setup.observation.times
    effect = InTime(CatalogueFlux(sources), Anew(times=tuple(times.tolist())))
    if scintillates:
        truth = {"kind": "catalogue_flux", "settings": effect.describe(), "strength": 1.0}
    else:
        drift = InTime(CatalogueFlux(sources), Smooth(orders=(2,)))
        (name,) = drift.parameters(plain.setup).names
        truth = {"kind": "catalogue_flux", "settings": drift.describe(), "parameters": {name: 0.3}}
    context = context_of(mock_job(truth, n_times=n_times), tmp_path)
    first = check(context, refit(context, Values()))
    start = Active.start(effect, context.setup, np.full(n_times, 0.01), np.zeros((1, n_times)))
    now = check(context, refit(context, Values((start,)), first.fitted))
    found = simplified(context, now, [round_of(effect_candidate(effect), first, now)], [CatalogueFlux()], [])
    assert (found is None) == scintillates
    if found is not None:
        (varying,) = found[0].after.fitted.values.active
        names = varying.effect.parameters(context.setup).names
        assert [names[i].split(", ")[1] for i in varying.used] == ["curvature"]
        error = varying.x[0, varying.used[0]] - 0.3
        assert abs(error) < 4 * found[0].after.fitted.fit.std[0][0, varying.used[0]] < 0.04


@pytest.mark.parametrize("turn", [2.0, 3.1])
def test_a_phase_that_jumps_was_taken_for_a_jittering_one(turn: float, tmp_path: Path) -> None:
    """However near half a turn it is: its fit begins where the phases are."""
    n_times = 18
    jump = float(context_of(mock_job(n_times=n_times), tmp_path / "plain").setup.observation.times[8:10].mean())
    effect = InTime(AntennaGains(), Piecewise(jumps=(jump,)))
    name = f"antenna 2 phase, {effect.time_law.names()[0]}"
    truth = {"kind": "antenna_gains", "settings": effect.describe(), "parameters": {name: turn}}
    context = context_of(mock_job(truth, n_times=n_times), tmp_path)
    jitter = GainJitter([(2, "phase")])
    first = check(context, refit(context, Values()))
    x = np.where(context.setup.observation.times >= jump, turn, 0.0)[np.newaxis]
    start = Active.start(jitter, context.setup, np.full(n_times, 4.0), x)
    now = check(context, refit(context, Values((start,)), first.fitted))
    found = simplified(context, now, [round_of(effect_candidate(jitter), first, now)], [AntennaGains()], [])
    assert found is not None
    (jumping,) = found[0].after.fitted.values.active
    (used,) = jumping.used
    assert jumping.effect.parameters(context.setup).names[used] == name
    assert abs(jumping.x[0, used] - turn) < 4 * found[0].after.fitted.fit.std[0][0, used]


def test_a_clock_that_was_right_at_most_times_has_nothing_constant(plain: FitContext, tmp_path: Path) -> None:
    """Its constant form would be a model with no parameter."""
    jump = 0.5 * plain.setup.observation.times[8:10].sum()
    effect = InTime(Timestamp(), Piecewise(jumps=(float(jump),))).in_full(plain.setup)
    (name,) = effect.parameters(plain.setup).names
    truth = {"kind": "timestamp", "parameters": {name: 30.0}, "settings": effect.describe()}
    context = context_of(mock_job(truth), tmp_path)
    first = check(context, refit(context, Values()))
    start = Active.start(effect, context.setup, np.full(1, 1e4), np.zeros((1, 1)))
    now = check(context, refit(context, Values((start,)), first.fitted))
    assert abs(now.fitted.values.active[0].x[0, 0] - 30.0) < 4 * now.fitted.fit.std[0][0, 0]
    assert simplified(context, now, [round_of(effect_candidate(effect), first, now)], [Timestamp()], []) is None


FOUR = tuple(131e6 + 3e6 * np.arange(4.0))
PURE = 2 * np.pi * np.mean(FOUR) * 3e-9  # rad, by which 3 ns turn the phase at the mean frequency
DELAY = {"kind": "antenna_delays", "parameters": {"antenna 2 delay": 3.0, "antenna 2 phase": PURE}}


def gains_of_all_channels(folder: Path, *truth: dict[str, object]) -> tuple[FitContext, Round]:
    """A round that has found gains of one antenna in each of four channels, fitted from near where they are."""
    context = context_of(mock_job(*truth, freqs=FOUR), folder)
    names = GAINS.parameters(context.setup).names
    used = np.isin(names, ["antenna 2 ln amplitude", "antenna 2 phase"])
    x = np.zeros((4, len(names)))
    if truth[0]["kind"] == "antenna_delays":
        x[:, names.index("antenna 2 phase")] = PURE * np.array(FOUR) / np.mean(FOUR)
    before = check(context, refit(context, Values()))
    active = Active.start(GAINS, context.setup, np.where(used, 1.0, 0.0), x)
    after = check(context, refit(context, Values((active,))))
    return context, round_of(effect_candidate(GAINS), before, after)


def test_a_delay_of_more_than_a_radian_in_the_place_of_gains_in_each_channel(tmp_path: Path) -> None:
    """From zero no linear model finds it: the phase is of 2.6 radians."""
    context, found = gains_of_all_channels(tmp_path, DELAY)
    found_simpler = simplified(context, found.after, [found], [GAINS, AntennaDelays()], [])
    assert found_simpler is not None
    added, places = found_simpler
    assert places == {0: None, 1: 0}
    (active,) = added.after.fitted.values.active
    assert active.kind == "antenna_delays"
    names = AntennaDelays().parameters(context.setup).names
    (std,) = added.after.fitted.fit.std
    delay, phase = names.index("antenna 2 delay"), names.index("antenna 2 phase")
    assert abs(active.x[0, delay] - 3.0) < 4 * std[0, delay]
    assert abs(np.angle(np.exp(1j * (active.x[0, phase] - PURE)))) < 4 * std[0, phase]
    assert simplified(context, found.after, [found], [GAINS], []) is None  # where delays are not looked for


def test_gains_that_are_the_same_in_all_channels(tmp_path: Path) -> None:
    """They are told by one number each, with an error that all channels make smaller."""
    context, found = gains_of_all_channels(tmp_path, GAIN)
    added, places = simplified(context, found.after, [found], [GAINS, AntennaDelays()], []) or pytest.fail("no law")
    assert places == {0: None, 1: 0}
    (active,) = added.after.fitted.values.active
    assert active.effect.describe() == {"channels": "alike"}
    assert active.effect.shared
    names = active.effect.parameters(context.setup).names
    for name, value in GAIN["parameters"].items():
        i = names.index(name)
        assert np.all(active.x[:, i] == active.x[0, i])
        assert abs(active.x[0, i] - value) < 4 * added.after.fitted.fit.std[0][0, i]
    assert "antenna gains, the same in all channels" in added.revised[0]
    assert simplified(context, added.after, [replace(added, place=0)], [GAINS, AntennaDelays()], []) is None


def test_gains_that_follow_no_law_keep_their_place(tmp_path: Path) -> None:
    """As those of an antenna that has an echo besides a delay."""
    echo = {"kind": "cable_reflections", "settings": {"reflections": [[2, 200.0]]}, "strength": 10.0}
    context, found = gains_of_all_channels(tmp_path, DELAY, echo)
    assert simplified(context, found.after, [found], [GAINS, AntennaDelays(), CableReflections()], []) is None


def test_delays_and_an_echo_in_the_place_of_gains_in_each_channel(tmp_path: Path) -> None:
    """Antennas are told apart by the law that their gains follow; one has the same gain in all channels."""
    freqs = tuple(131e6 + 1e6 * np.arange(8.0))
    delays = {"antenna 2 delay": 3.0, "antenna 2 phase": 0.1, "antenna 5 delay": -6.0, "antenna 5 phase": -0.2}
    echo = {"reflections": [[4, 200.0]]}
    context = context_of(
        mock_job(
            {"kind": "antenna_delays", "parameters": delays},
            {
                "kind": "cable_reflections",
                "settings": echo,
                "parameters": {"antenna 4 reflection at 200.0 ns real": 0.1},
            },
            {"kind": "antenna_gains", "parameters": {"antenna 1 ln amplitude": 0.1}},
            freqs=freqs,
        ),
        tmp_path,
    )
    names = GAINS.parameters(context.setup).names
    used = np.array([any(name.startswith(f"antenna {number} ") for number in (1, 2, 4, 5)) for name in names])
    before = check(context, refit(context, Values()))
    active = Active.start(GAINS, context.setup, np.where(used, 0.1, 0.0), np.zeros((8, len(names))))
    after = check(context, refit(context, Values((active,))))
    found = round_of(effect_candidate(GAINS), before, after)
    wanted = [GAINS, AntennaDelays(), CableReflections()]
    rounds = [found]
    for left in ({0: 0, 1: 1}, {0: 0, 1: 1, 2: 2}, {0: None, 1: 0, 2: 1, 3: 2}):
        added, places = simplified(context, rounds[-1].after, rounds, wanted, []) or pytest.fail("no law was found")
        assert places == left
        rounds.append(added)
    again = rounds[-1]
    gain, of_delays, of_echo = again.after.fitted.values.active
    assert gain.effect.describe() == {"channels": "alike"}
    assert {names[i] for i in gain.used} == {"antenna 1 ln amplitude", "antenna 1 phase"}
    known = AntennaDelays().parameters(context.setup).names
    assert {known[i] for i in of_delays.used} == set(delays)
    for name, value in delays.items():
        i = known.index(name)
        assert abs(of_delays.x[0, i] - value) < 4 * again.after.fitted.fit.std[1][0, i]
    told = of_echo.effect.told(context.setup, of_echo.x, again.after.fitted.fit.std[2])
    np.testing.assert_array_less(np.abs(told.values[0] - [0.1, 0.0, 200.0]), 4 * told.std[0])
    assert simplified(context, again.after, [replace(again, place=place) for place in range(3)], wanted, []) is None


@pytest.mark.parametrize("elsewhere", [0.0, 0.4])
def test_an_array_that_is_turned_in_the_place_of_the_positions_of_all_antennas(
    elsewhere: float, tmp_path: Path
) -> None:
    """Beside it one antenna may stand higher than it should."""
    turned = {"kind": "orientation", "settings": {"fixed": "array"}, "parameters": {"turn about Up": 30.0}}
    higher = {"kind": "antenna_positions", "parameters": {"antenna 2 displaced Up": elsewhere}}
    context = context_of(mock_job(turned, higher), tmp_path)
    positions = AntennaPositions()
    n = len(positions.parameters(context.setup))
    first = check(context, refit(context, Values()))
    start = Active.start(positions, context.setup, np.full(n, 0.1**2), np.zeros((1, n)))
    now = check(context, fit_patiently(context, Values((start,)), first.fitted))
    assert now.score.chi2 == pytest.approx(1, abs=0.2)
    so_far = [round_of(effect_candidate(positions), first, now)]
    found = simplified(context, now, so_far, [Orientation(), positions], [])
    assert found is not None
    *others, turn = found[0].after.fitted.values.active
    assert turn.effect.describe()["fixed"] == "array"
    assert turn.x[0] == pytest.approx([0.0, 0.0, 30.0], abs=0.5)
    assert len(others) == (elsewhere > 0)
    if others:
        used = others[0].used
        assert set(used) <= {6, 7, 8}
        assert others[0].x[0, 8] == pytest.approx(elsewhere, abs=0.05)


def test_an_array_of_another_size_in_the_place_of_the_positions_of_all_antennas(tmp_path: Path) -> None:
    larger = {"kind": "array_scale", "parameters": {"baselines longer than stated": 1.0}}
    context = context_of(mock_job(larger), tmp_path)
    positions = AntennaPositions()
    n = len(positions.parameters(context.setup))
    first = check(context, refit(context, Values()))
    start = Active.start(positions, context.setup, np.full(n, 0.1**2), np.zeros((1, n)))
    now = check(context, fit_patiently(context, Values((start,)), first.fitted))
    so_far = [round_of(effect_candidate(positions), first, now)]
    found = simplified(context, now, so_far, [ArrayScale(), Orientation(), positions], [])
    assert found is not None
    (scale,) = found[0].after.fitted.values.active
    assert scale.effect.kind == "array_scale"
    assert abs(scale.x[0, 0] - 1.0) < 4 * found[0].after.fitted.fit.std[0][0, 0]


def test_antennas_that_stand_anywhere_are_no_array_that_is_turned(tmp_path: Path) -> None:
    names = AntennaPositions().parameters(context_of(mock_job(), tmp_path).setup).names
    shifts = dict(zip(names, 0.1 * generator(3, "anywhere").standard_normal(len(names)), strict=True))
    context = context_of(mock_job({"kind": "antenna_positions", "parameters": shifts}), tmp_path)
    positions = AntennaPositions()
    first = check(context, refit(context, Values()))
    start = Active.start(positions, context.setup, np.full(len(names), 0.1**2), np.zeros((1, len(names))))
    now = check(context, fit_patiently(context, Values((start,)), first.fitted))
    so_far = [round_of(effect_candidate(positions), first, now)]
    assert simplified(context, now, so_far, [Orientation(), positions], []) is None
