"""Effects that explain the residual together are fitted as a whole."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.instrument.antenna_positions import AntennaPositions
from hydrabeam_mpi.effects.instrument.closure_errors import ClosureErrors
from hydrabeam_mpi.effects.instrument.cross_coupling import CrossCoupling
from hydrabeam_mpi.effects.instrument.timestamp import Timestamp
from hydrabeam_mpi.effects.sky.missing_sources import MissingSources
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.state import Active, Ended, Fitted, Values
from hydrabeam_mpi.loop.attribution.score_effects import Finding, attribute
from hydrabeam_mpi.loop.rules import RULES
from hydrabeam_mpi.loop.selection import whole_set
from hydrabeam_mpi.loop.selection.acceptance import Candidate, Checked, Round, is_better
from hydrabeam_mpi.loop.selection.predictions import check
from hydrabeam_mpi.loop.selection.refits import rise
from hydrabeam_mpi.loop.selection.trials import refusal_of_fit, try_effects
from hydrabeam_mpi.loop.selection.weighing import Outlook, Together, Weighed, weigh
from hydrabeam_mpi.loop.selection.whole_set import as_one, try_set
from tests.fit.test_gauss_newton import free
from tests.loop.mock import context_of, mock_job

GAIN = {"kind": "antenna_gains", "parameters": {"antenna 2 ln amplitude": 0.006, "antenna 2 phase": -0.005}}
COUPLED = {"kind": "cross_coupling", "settings": {"baselines": [[1, 4]]}, "parameters": {"baseline 1-4 real": 0.0005}}
EFFECTS = [AntennaGains(), CrossCoupling([[0, 3], [1, 4], [2, 5]])]
PUT_IN = {"antenna 2 ln amplitude": 0.006, "antenna 2 phase": -0.005, "baseline 1-4 real": 0.0005}


@pytest.fixture(scope="module")
def context(tmp_path_factory: pytest.TempPathFactory) -> FitContext:
    return context_of(mock_job(GAIN, COUPLED), tmp_path_factory.mktemp("set"))


@pytest.fixture(scope="module")
def before(context: FitContext) -> Checked:
    return check(context, refit(context, Values()))


@pytest.fixture(scope="module")
def factors(context: FitContext) -> ClosureErrors:
    return ClosureErrors([pair for pair in context.setup.observation.antpairs.tolist() if 2 in pair])


@pytest.fixture(scope="module")
def weighed(context: FitContext, before: Checked, factors: ClosureErrors) -> Weighed:
    return weigh(context, before.fitted, [*EFFECTS, factors], [], 6)


@pytest.fixture(scope="module")
def rounds(context: FitContext, before: Checked, weighed: Weighed) -> tuple[Round, ...]:
    tried: list = []
    found = try_set(context, before, weighed, tried)
    assert tried == []
    return found


def test_all_of_a_set_are_found_at_once(context: FitContext, before: Checked, rounds: tuple[Round, ...]) -> None:
    assert [one.candidate.kind for one in rounds] == ["antenna_gains", "cross_coupling"]
    assert [one.place for one in rounds] == [0, 1]
    assert rounds[0].before is before
    assert rounds[1].before is rounds[0].after
    assert not rounds[0].after.remains.consistent
    last = rounds[1].after
    assert last.remains.consistent
    told = {}
    for one, std in zip(last.fitted.values.active, last.fitted.fit.std, strict=True):
        names = one.effect.parameters(context.setup).names
        told |= {names[i]: (one.x[0, i], sigma) for i, sigma in zip(one.used, std[0][one.used], strict=True)}
    assert set(PUT_IN) <= set(told)
    for name, (value, sigma) in told.items():
        assert abs(value - PUT_IN.get(name, 0.0)) < 4 * sigma
    # As they are after the second; the first alone is not fitted to what the second explains.
    first, both = (one.after.fitted.values.active[0].x for one in rounds)
    np.testing.assert_array_equal(first, both)


def test_evidences_of_the_rounds_add_up_to_that_of_the_set(
    context: FitContext, before: Checked, rounds: tuple[Round, ...]
) -> None:
    whole = as_one(rounds)
    total = sum(one.candidate.log_bayes_factor for one in rounds)
    assert whole.candidate.log_bayes_factor == pytest.approx(total)
    prices = 0.0
    for one in rounds:
        assert one.candidate.finding is not None
        evidence = one.candidate.finding.evidence
        of_fit = rise(context, one.before.fitted, one.after.fitted)
        prices += one.candidate.log_bayes_factor - of_fit
        # What a width and the choice of an element cost.
        assert -15 * evidence.n_parameters < one.candidate.log_bayes_factor - of_fit < 0
    assert total == pytest.approx(rise(context, before.fitted, rounds[-1].after.fitted) + prices)
    assert whole.before is before
    assert whole.after is rounds[-1].after


def test_members_and_their_laws_are_no_rivals(
    context: FitContext, before: Checked, weighed: Weighed, rounds: tuple[Round, ...]
) -> None:
    outlook, tried, whole = Outlook(context, EFFECTS, [], 6, weighed), [], as_one(rounds)
    assert try_effects(context, before, weighed.ranking, tried, whole, outlook) is whole
    assert tried == []
    assert outlook.ahead is None


def test_what_explains_all_has_to_beat_the_whole_set_and_not_its_first(
    context: FitContext, rounds: tuple[Round, ...]
) -> None:
    """Factors of all baselines stand for the gain of one antenna and a coupling together, at more parameters."""
    whole, all_at_once = as_one(rounds), check(context, _fit_of_truth(context))
    better_by = all_at_once.score.log_density - whole.after.score.log_density
    for ahead, better in ((-1.0, False), (1.0, True)):
        rival = Candidate("closure_errors", "closure errors", whole.candidate.log_bayes_factor - better_by + ahead)
        assert is_better(rival, all_at_once, rounds[0])
        assert is_better(rival, all_at_once, whole) == better


def _fit_of_truth(context: FitContext) -> Fitted:
    """Fit what was put into the data."""
    active = []
    for effect in EFFECTS:
        names = effect.parameters(context.setup).names
        prior_var = np.array([float(name in PUT_IN) for name in names])
        active.append(Active.start(effect, context.setup, prior_var, np.zeros((1, len(names)))))
    return refit(context, Values(tuple(active)))


def test_what_has_no_evidence_beside_the_others_leaves_the_set(
    context: FitContext, before: Checked, weighed: Weighed
) -> None:
    """Factors of baselines with an antenna stand for its gain, and for nothing beside it."""
    alone = next(one for one in weighed.ranking if one.kind == "closure_errors")
    together = Together((*weighed.together.members, alone), (*weighed.together.beside, (alone,)))
    found = try_set(context, before, replace(weighed, together=together), [])
    assert [one.candidate.kind for one in found] == ["antenna_gains", "cross_coupling"]
    assert len(found[-1].after.fitted.values.active) == 2


def refusing(kind: str) -> Callable[..., str | None]:
    """Return what stands for `refusal_of_fit` and refuses effects of one kind alone."""

    def refusal(context: FitContext, before: Checked, after: Checked, fitted: Candidate, whole: Fitted) -> str | None:
        return "for a test" if fitted.kind == kind else None

    return refusal


def test_one_that_held_out_data_refuse_goes_and_the_others_stay(
    context: FitContext, before: Checked, weighed: Weighed, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(whole_set, "refusal_of_fit", refusing("antenna_gains"))
    tried: list = []
    assert try_set(context, before, weighed, tried) == ()
    assert [(one.kind, reason) for one, reason in tried] == [("antenna_gains", "for a test")]


def test_the_others_are_fitted_again_from_where_they_were(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The linear model, by which others might come back that were taken back since, is left once."""
    context, before, weighed = with_one_moved(tmp_path, 0.01)
    assert len(weighed.together.members) == 3

    begun = []

    def fit(context: FitContext, values: Values, start: Fitted) -> Fitted:
        begun.append((len(values.active), start is before.fitted))
        return refit(context, values, start)

    monkeypatch.setattr(whole_set, "refusal_of_fit", refusing("cross_coupling"))
    monkeypatch.setattr(whole_set, "fit_patiently", fit)
    tried: list = []
    found = try_set(context, before, replace(weighed, simpler=()), tried)
    assert {one.candidate.kind for one in found} == {"antenna_gains", "antenna_positions"}
    assert [one.kind for one, _ in tried] == ["cross_coupling"]
    assert begun == [(3, True), (2, False)]


def test_what_a_rival_explains_leaves_a_set_before_held_out_data_are_asked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Here a gain stands for a fault of the beam: beside that there is nothing of the same gain."""
    context, before, weighed = with_one_moved(tmp_path, 0.01)
    rival = next(one for one in weighed.ranking if one.kind == "antenna_gains")
    asked = []

    def refusal(context: FitContext, before: Checked, after: Checked, fitted: Candidate, whole: Fitted) -> str | None:
        asked.append(fitted.kind)
        return refusal_of_fit(context, before, after, fitted, whole)

    monkeypatch.setattr(whole_set, "rivals_of", lambda *_: [rival])
    monkeypatch.setattr(whole_set, "refusal_of_fit", refusal)
    tried: list = []
    found = try_set(context, before, replace(weighed, simpler=()), tried)
    assert [one.kind for one, _ in tried] == ["antenna_gains"]
    assert "antenna gains explains as much" in tried[0][1]
    assert sorted(asked) == sorted(one.candidate.kind for one in found) == ["antenna_positions", "cross_coupling"]


def with_one_moved(folder: Path, metres: float) -> tuple[FitContext, Checked, Weighed]:
    """A gain, a coupling and an antenna that is off its place, as they are weighed."""
    moved = {"kind": "antenna_positions", "parameters": {"antenna 4 displaced East": metres}}
    context = context_of(mock_job(GAIN, COUPLED, moved), folder)
    before = check(context, refit(context, Values()))
    return context, before, weigh(context, before.fitted, [*EFFECTS, AntennaPositions()], [], 6)


def test_what_the_others_have_may_be_what_the_linear_model_lacks_of_the_first(tmp_path: Path) -> None:
    """Where one that is not linear has nearly all of the evidence it is fitted before the others are believed."""
    context, before, weighed = with_one_moved(tmp_path, 0.05)
    assert weighed.explains
    assert weighed.together.members[0].kind == "antenna_positions"
    assert len(weighed.together.members) > 1
    assert try_set(context, before, weighed, []) == ()


@pytest.mark.parametrize(("log_bayes_factor", "n_fits"), [(0.0, 1), (1e12, 2)])
def test_the_simplest_set_comes_first_and_others_only_for_more_evidence_than_its_fit_has(
    context: FitContext,
    before: Checked,
    weighed: Weighed,
    log_bayes_factor: float,
    n_fits: int,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def with_more(one: Candidate) -> Candidate:
        assert one.finding is not None
        evidence = replace(one.finding.evidence, effective_parameters=9.0)
        return replace(one, finding=replace(one.finding, evidence=evidence))

    larger = replace(weighed.together, members=tuple(map(with_more, weighed.together.members)))
    both = replace(weighed, together=replace(larger, log_bayes_factor=log_bayes_factor), simpler=(weighed.together,))
    capsys.readouterr()
    found = try_set(context, before, both, [])
    assert {one.candidate.kind for one in found} == {"antenna_gains", "cross_coupling"}
    assert capsys.readouterr().err.count("trying together") == n_fits


def test_what_others_have_beyond_the_best_is_left_to_the_next_round(
    context: FitContext, before: Checked, weighed: Weighed, capsys: pytest.CaptureFixture[str]
) -> None:
    (further,) = attribute(context, before.fitted, [AntennaPositions()])
    further = replace(further, evidence=replace(further.evidence, effective_parameters=9.0))
    members = (*weighed.together.members, Candidate.of(further))
    larger = Together(members, tuple((one,) for one in members), log_bayes_factor=1e12)
    capsys.readouterr()
    found = try_set(context, before, replace(weighed, together=larger, simpler=(weighed.together,)), [])
    assert {one.candidate.kind for one in found} == {"antenna_gains", "cross_coupling"}
    assert capsys.readouterr().err.count("trying together") == 1


def test_what_was_refused_in_a_set_is_left_out_of_those_after_it(
    context: FitContext, before: Checked, weighed: Weighed, monkeypatch: pytest.MonkeyPatch
) -> None:
    moved, closure = (
        Candidate.of(replace(one, evidence=replace(one.evidence, effective_parameters=9.0)))
        for one in attribute(context, before.fitted, [AntennaPositions(), ClosureErrors()])
    )
    simple, begun = weighed.together, []
    further = Together((*simple.members, moved, closure), (*simple.beside, (moved,), (closure,)))

    def fit(context: FitContext, values: Values, start: Fitted) -> Fitted:
        if start is before.fitted:
            begun.append([one.effect.kind for one in values.active])
        return refit(context, values, start)

    monkeypatch.setattr(whole_set, "refusal_of_fit", refusing("antenna_gains"))
    monkeypatch.setattr(whole_set, "fit_patiently", fit)
    try_set(context, before, replace(weighed, together=further, simpler=(simple,)), [])
    assert begun == [["antenna_gains", "cross_coupling"], ["cross_coupling", "antenna_positions", "closure_errors"]]


def test_one_effect_is_no_set(context: FitContext, before: Checked, weighed: Weighed) -> None:
    alone = Together(weighed.together.members[:1], weighed.together.beside[:1])
    assert try_set(context, before, replace(weighed, together=alone), []) == ()
    assert try_set(context, before, Weighed(weighed.ranking), []) == ()


def test_a_set_whose_fit_does_not_converge_is_tried_one_by_one(
    context: FitContext, before: Checked, weighed: Weighed, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unsettled(context: FitContext, values: Values, start: Fitted) -> Fitted:
        fitted = refit(context, values, start)
        return replace(fitted, diagnostics=replace(fitted.diagnostics, ended=Ended.STUCK))

    monkeypatch.setattr(whole_set, "fit_patiently", unsettled)
    assert try_set(context, before, weighed, []) == ()


def test_what_is_picked_from_a_grid_is_tried_by_itself(context: FitContext, before: Checked, weighed: Weighed) -> None:
    """Several sources that vary may make up for one beside its place, beside whatever else there is."""
    first, second = weighed.together.members
    source = Candidate.of(Finding(MissingSources([(50.0, -30.0)]), second.finding.evidence)) if second.finding else None
    assert source is not None
    assert source.finding is not None
    assert source.finding.effect.gets_simpler_when_fitted
    for members in ((first, source), (source, first, second)):
        together = Together(members, tuple((one,) for one in members))
        assert try_set(context, before, replace(weighed, together=together), []) == ()


def test_of_a_set_that_leaves_more_than_noise_those_are_fitted_that_none_stands_for(
    context: FitContext, before: Checked, weighed: Weighed, rounds: tuple[Round, ...]
) -> None:
    """Something else may be missing as well, which no effect or no linear model tells."""
    found = try_set(context, before, replace(weighed, explains=False), [])
    assert [one.candidate.kind for one in found] == ["antenna_gains", "cross_coupling"]
    gains, coupling = weighed.together.members
    (alone,) = (one for one in weighed.ranking if one.kind == "antenna_gains")
    for part, n in ((1.01, 2), (0.99, 0)):
        # As if the coupling took up so much of what the gains explain by themselves.
        left = replace(gains, log_bayes_factor=part * RULES.near_if_linear * alone.log_bayes_factor)
        together = replace(weighed.together, members=(left, coupling))
        assert len(try_set(context, before, replace(weighed, together=together, explains=False), [])) == n
        assert len(try_set(context, before, replace(weighed, together=together), [])) == 2
    # Where no effect by itself comes near what all of them explain, they are fitted all the same.
    weak = tuple(replace(one, log_bayes_factor=0.1 * one.log_bayes_factor) for one in weighed.ranking)
    left = replace(gains, log_bayes_factor=0.05 * alone.log_bayes_factor)
    together = replace(weighed.together, members=(left, coupling))
    far = replace(weighed, ranking=weak, together=together, explains=False)
    assert len(try_set(context, before, far, [])) == 2
    left_more = replace(together, log_bayes_factor=0.5 * together.log_bayes_factor)
    assert len(try_set(context, before, replace(far, together=left_more), [])) == 0


def test_what_explains_nothing_without_another_comes_after_it(tmp_path: Path) -> None:
    """Positions of all antennas have taken up a part of a clock that is late, which they give back once it is there."""
    gain, clock = "antenna 2 ln amplitude", "time by which data are later than their timestamps"
    wrong = {"antenna_gains": {gain: 0.01}, "timestamp": {clock: 4.0}}
    injected = ({"kind": kind, "parameters": parameters} for kind, parameters in wrong.items())
    context = context_of(mock_job(*injected, n_times=24), tmp_path)
    before = check(context, refit(context, Values((free(context, AntennaPositions(), 1.0),))))
    weighed, tried = weigh(context, before.fitted, [AntennaGains(), Timestamp()], [], 6), list[tuple[Candidate, str]]()
    assert [one.kind for one in weighed.together.members] == ["antenna_gains", "timestamp"]
    rounds = try_set(context, before, weighed, tried)
    assert [one.candidate.kind for one in rounds] == ["timestamp", "antenna_gains"]
    assert tried == []
    last = rounds[-1].after
    assert last.remains.consistent
    for place, name, true in ((1, clock, 4.0), (2, gain, 0.01)):
        one = last.fitted.values.active[place]
        number = one.effect.parameters(context.setup).names.index(name)
        assert abs(one.x[0, number] - true) < 4 * last.fitted.fit.std[place][0, number]
