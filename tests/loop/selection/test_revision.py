"""What becomes of effects in the model when they are weighed again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.instrument.closure_errors import ClosureErrors
from hydrabeam_mpi.effects.instrument.cross_coupling import CrossCoupling
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.registry import make_effect
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.state import Active, Values
from hydrabeam_mpi.loop.selection.acceptance import Round
from hydrabeam_mpi.loop.selection.predictions import check
from hydrabeam_mpi.loop.selection.revision import Revision, revise, revised_as_far_as_better, reweigh
from hydrabeam_mpi.loop.selection.taken_back import take_back_faint
from tests.loop.made import effect_candidate, round_of
from tests.loop.mock import context_of, mock_job

GAIN = {"kind": "antenna_gains", "parameters": {"antenna 2 ln amplitude": 0.06, "antenna 2 phase": -0.05}}
COUPLING = CrossCoupling([[1, 4]])
GAINS = AntennaGains()


@pytest.fixture(scope="module")
def context(tmp_path_factory: pytest.TempPathFactory) -> FitContext:
    return context_of(mock_job(GAIN), tmp_path_factory.mktemp("revision"))


def round_with(context: FitContext, *effects: Effect, newest: Effect | None) -> Round:
    """Return a round after which the model has some effects; the newest, or None for a change of the weights."""
    widths = {GAINS: 0.05, COUPLING: 0.1}
    active = []
    for one in effects:
        n = len(one.parameters(context.setup))
        active.append(Active.start(one, context.setup, np.full(n, widths[one] ** 2), np.zeros((1, n))))
    before, after = (check(context, refit(context, Values(values))) for values in ((), tuple(active)))
    candidate = effect_candidate(newest or effects[-1])
    return round_of(candidate if newest else replace(candidate, finding=None), before, after)


def test_what_is_not_wanted_any_more_is_taken_back(context: FitContext) -> None:
    """A coupling that is not there, once the gain is in the model; of the gains one antenna's stays."""
    found = round_with(context, COUPLING, GAINS, newest=GAINS)
    last, places = revise(context, found, 0)
    assert places == {0: None, 1: 0}
    (gains,) = last.after.fitted.values.active
    names = GAINS.parameters(context.setup).names
    assert {names[i] for i in gains.used} == {"antenna 2 ln amplitude", "antenna 2 phase"}
    assert [line.split(":")[0] for line in last.revised] == [COUPLING.title, GAINS.title]
    assert "taken back" in last.revised[0]


def test_nothing_is_revised_where_held_out_data_are_predicted_worse_without_it(context: FitContext) -> None:
    """The same, after a fit that left half as much of the held-out data, by more than that scatters over blocks."""
    found = round_with(context, COUPLING, GAINS, newest=GAINS)
    numbers, half = found.after.numbers, np.array([[0.5], [1.0]])
    nearer = replace(numbers, times=half * numbers.times, groups=half * numbers.groups)
    before = replace(found, after=replace(found.after, numbers=nearer))
    assert revise(context, before, 0) == (before, {0: 0, 1: 1})


def test_what_is_faint_at_the_end_is_taken_back(context: FitContext) -> None:
    """The same coupling; the gains stay as they were, and so does what the job has in its model."""
    found = round_with(context, COUPLING, GAINS, newest=GAINS)
    last, places, _ = take_back_faint(context, found, 0)
    assert places == {0: None, 1: 0}
    (gains,), (_, before) = (one.after.fitted.values.active for one in (last, found))
    np.testing.assert_array_equal(gains.used, before.used)
    (told,) = last.revised
    assert told.startswith(f"{COUPLING.title}: taken back")
    assert take_back_faint(context, found, 1) == (found, {0: 0, 1: 1}, {})


def test_what_cannot_be_revised_at_once_is_revised_one_by_one(context: FitContext) -> None:
    """Without the gains nothing would explain the data; without the coupling they do."""
    fitted = round_with(context, COUPLING, GAINS, newest=GAINS).after.fitted
    without_gains, without_coupling = Revision(1, None, 2.0), Revision(0, None, 1.0)
    found = revised_as_far_as_better(context, fitted, [without_gains, without_coupling], 5.0)
    assert found is not None
    assert found.places == {0: None, 1: 0}
    assert revised_as_far_as_better(context, fitted, [without_gains], 5.0) is None
    assert revised_as_far_as_better(context, fitted, [], 5.0) is None


def test_effects_of_the_job_stay_as_they_are(context: FitContext) -> None:
    found = round_with(context, COUPLING, newest=None)
    assert revise(context, found, 1) == (found, {0: 0})


def test_a_single_effect_is_weighed_again_after_a_change_of_the_weights_only(context: FitContext) -> None:
    """Not when it has just been found."""
    fresh = round_with(context, COUPLING, newest=COUPLING)
    assert revise(context, fresh, 0) == (fresh, {0: 0})
    last, places = revise(context, round_with(context, COUPLING, newest=None), 0)
    assert places == {0: None}
    assert last.after.fitted.values.active == ()


def test_what_an_effect_has_not_in_use_takes_the_place_of_another(context: FitContext) -> None:
    """A gain whose phase was told as factors of all baselines of its antenna."""
    factors = ClosureErrors([pair for pair in context.setup.observation.antpairs.tolist() if 2 in pair])
    names = GAINS.parameters(context.setup).names
    amplitude = np.where(np.array(names) == "antenna 2 ln amplitude", 0.05**2, 0.0)
    n = len(factors.parameters(context.setup))
    active = (
        Active.start(GAINS, context.setup, amplitude, np.zeros((1, 14))),
        Active.start(factors, context.setup, np.full(n, 0.05**2), np.zeros((1, n))),
    )
    fitted, told = refit(context, Values(active)), list[str]()
    while (found := reweigh(context, fitted, range(len(fitted.values.active)))) is not None:
        fitted, told = found.fitted, [*told, *found.told]
    (gains,) = fitted.values.active
    assert {names[i] for i in gains.used} == {"antenna 2 ln amplitude", "antenna 2 phase"}
    assert f"{factors.title}: taken back, as the model is better without it" in told
    assert any(line.endswith(", with 1 more") for line in told)


PLACE = (31.37, -28.64)
NAME = "source at ra=31.370 dec=-28.640: flux"


@pytest.mark.parametrize("drift", [0.0, 2.0], ids=["constant", "varying"])
def test_sources_that_varied_while_something_was_missing(drift: float, tmp_path: Path) -> None:
    """Once that is in the model they are constant if the evidence is higher so, and stay as they are if not."""
    law = {"law": "smooth", "orders": [0, 1], "sources": [list(PLACE)]}
    fluxes = {f"{NAME}, level": 3.0, f"{NAME}, drift from first to last time": drift}
    context = context_of(mock_job(GAIN, {"kind": "missing_sources", "settings": law, "parameters": fluxes}), tmp_path)
    varying = make_effect("missing_sources", law).in_full(context.setup)
    names = varying.parameters(context.setup).names
    prior_var = np.array([9.0 if "flux" in name else 0.0 for name in names])
    x = np.array([[fluxes.get(name, 0.0) for name in names]])
    gain = Active.start(GAINS, context.setup, np.full(14, 0.05**2), np.zeros((1, 14)))
    active = (Active.start(varying, context.setup, prior_var, x), gain)
    before, after = (check(context, refit(context, Values(values))) for values in ((), active))
    last, places = revise(context, round_of(effect_candidate(GAINS), before, after), 0)
    assert places == {0: 0, 1: 1}
    found = last.after.fitted.values.active[0]
    labels = [name for name, _ in found.labels(context.setup)]
    if drift:
        assert found.effect is varying
        assert set(fluxes) <= set(labels)
    else:
        assert found.effect.law == "constant"
        assert labels[0] == NAME
        assert abs(found.x[0, 0] - 3.0) < 4 * last.after.fitted.fit.std[0][0, 0]
        assert any("as the model is better without what changes" in line for line in last.revised)
