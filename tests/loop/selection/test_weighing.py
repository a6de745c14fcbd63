"""What may be tried: each effect by itself, and those that explain the residual together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.instrument.closure_errors import ClosureErrors
from hydrabeam_mpi.effects.instrument.cross_coupling import CrossCoupling
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.error_scale import fitted_chi2
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.state import Active, Fitted, Values
from hydrabeam_mpi.loop.attribution import weigh_together
from hydrabeam_mpi.loop.rules import RULES, Rules
from hydrabeam_mpi.loop.selection.acceptance import Candidate, is_better
from hydrabeam_mpi.loop.selection.predictions import check
from hydrabeam_mpi.loop.selection.trials import try_effects
from hydrabeam_mpi.loop.selection.weighing import Outlook, Weighed, weigh
from tests.loop.mock import context_of, mock_job

GAIN = {"kind": "antenna_gains", "parameters": {"antenna 2 ln amplitude": 0.006, "antenna 2 phase": -0.005}}
COUPLED = {"kind": "cross_coupling", "settings": {"baselines": [[1, 4]]}, "parameters": {"baseline 1-4 real": 0.0005}}
EFFECTS = [AntennaGains(), CrossCoupling([[0, 3], [1, 4], [2, 5]])]


@pytest.fixture(scope="module")
def context(tmp_path_factory: pytest.TempPathFactory) -> FitContext:
    return context_of(mock_job(GAIN, COUPLED), tmp_path_factory.mktemp("weighing"))


@pytest.fixture(scope="module")
def weighed(context: FitContext) -> Weighed:
    factors = ClosureErrors([pair for pair in context.setup.observation.antpairs.tolist() if 2 in pair])
    return weigh(context, refit(context, Values()), [*EFFECTS, factors], [], 6)


def test_two_effects_together_without_what_stands_for_one_of_them(context: FitContext, weighed: Weighed) -> None:
    assert {one.kind for one in weighed.ranking} == {"antenna_gains", "cross_coupling", "closure_errors"}
    assert [one.kind for one in weighed.together.members] == ["antenna_gains", "cross_coupling"]
    assert weighed.first is next(one for one in weighed.ranking if one.kind == "antenna_gains")
    gains, coupling = weighed.together.members
    for one, wanted in ((gains, {"antenna 2 ln amplitude", "antenna 2 phase"}), (coupling, {"baseline 1-4 real"})):
        assert one.finding is not None
        names = one.finding.effect.parameters(context.setup).names
        x = np.abs(one.finding.evidence.x[0])
        assert {names[i] for i in np.argsort(-x)[: len(wanted)]} == wanted
    for member, beside in zip(weighed.together.members, weighed.together.beside, strict=True):
        assert beside[0] is member
        assert [one.log_bayes_factor for one in beside] == sorted((o.log_bayes_factor for o in beside), reverse=True)


def test_both_are_found_without_weighing_again(context: FitContext, weighed: Weighed) -> None:
    tried: list = []
    before = check(context, refit(context, Values()))
    outlook = Outlook(context, EFFECTS, [], 6, weighed)
    first = try_effects(context, before, weighed.ranking, tried, outlook=outlook)
    assert first is not None
    assert [one.kind for one in weighed.ranking if outlook.comes_next(one, first)] == ["cross_coupling"]
    assert outlook.explains_rest(first)
    assert outlook.ahead is None
    assert first.candidate.kind == "antenna_gains"
    assert not first.after.remains.consistent
    rest = weighed.after(first.candidate)
    assert rest is not None
    then = Weighed.next_of(rest)
    second = try_effects(context, first.after, then.ranking, tried, outlook=Outlook(context, EFFECTS, [], 5, then))
    assert second is not None
    assert second.candidate.kind == "cross_coupling"
    assert second.after.remains.consistent
    assert tried == []
    assert then.after(second.candidate) is None
    assert weighed.after(second.candidate) is None


def test_what_explains_all_has_to_beat_the_whole_set_and_not_its_first(context: FitContext, weighed: Weighed) -> None:
    """Factors of all baselines stand for the gain of one antenna and a coupling together, at more parameters."""
    assert weighed.explains
    before = check(context, refit(context, Values()))
    outlook = Outlook(context, EFFECTS, [], 6, weighed)
    first = try_effects(context, before, weighed.ranking[:1], [], outlook=outlook)
    assert first is not None
    assert first.candidate.kind == weighed.together.members[0].kind
    rest = weighed.after(first.candidate)
    assert rest is not None
    whole = first.candidate.log_bayes_factor + sum(one.log_bayes_factor for one in rest.members)
    all_at_once = check(context, fit_of_truth(context))
    assert all_at_once.remains.consistent
    left, noise = fitted_chi2(context, all_at_once.fitted)
    nothing_left = max(left - noise, 0.0)
    for ahead, better in ((-1.0, False), (1.0, True)):
        rival = Candidate("closure_errors", "closure errors", whole - nothing_left + ahead)
        assert rival.log_bayes_factor > first.candidate.log_bayes_factor
        assert is_better(rival, all_at_once, first)
        assert outlook.is_better(rival, all_at_once, first) == better


def fit_of_truth(context: FitContext) -> Fitted:
    """Fit what was put into the data."""
    put_in = {"antenna 2 ln amplitude", "antenna 2 phase", "baseline 1-4 real"}
    active = []
    for effect in EFFECTS:
        names = effect.parameters(context.setup).names
        prior_var = np.array([float(name in put_in) for name in names])
        active.append(Active.start(effect, context.setup, prior_var, np.zeros((1, len(names)))))
    return refit(context, Values(tuple(active)))


def test_no_more_effects_than_may_be_added(context: FitContext, weighed: Weighed) -> None:
    fitted = refit(context, Values())
    assert len(weighed.together.members) == 2
    assert [one.kind for one in weigh(context, fitted, EFFECTS, [], 1).together.members] == ["antenna_gains"]
    assert weigh(context, fitted, EFFECTS, [], 0).together.members == ()


def test_what_is_worth_less_than_the_linear_model_was_wrong_by_is_weighed_again(weighed: Weighed) -> None:
    gains, coupling = weighed.together.members
    assert weighed.first is not None
    for wrong_by, left in ((0.9, (coupling,)), (1.1, None)):
        found = weighed.first.log_bayes_factor + wrong_by * coupling.log_bayes_factor
        rest = weighed.after(replace(gains, log_bayes_factor=found))
        assert (rest and rest.members) == left


def test_what_a_fit_makes_something_else_of_was_not_chosen_by_what_is_so(weighed: Weighed) -> None:
    rest = weighed.after(weighed.together.members[0])
    assert rest is not None
    then, expected = Weighed.next_of(rest), rest.members[0]
    for factor, is_of_use in ((1.0, True), (1.9, True), (2.1, False), (10.0, False), (0.1, True), (-0.1, False)):
        fitted = replace(expected, log_bayes_factor=factor * expected.log_bayes_factor)
        assert then.is_of_use(fitted) is is_of_use


def test_columns_are_those_in_use_and_further_ones_that_gain_alone_while_there_is_room(
    context: FitContext, weighed: Weighed, monkeypatch: pytest.MonkeyPatch
) -> None:
    fitted = refit(context, Values())
    findings = [one.finding for one in weighed.ranking if one.finding is not None]
    picked = weigh_together.columns_that_matter(context, fitted, findings)
    assert [one for one, _ in picked] == findings
    for one, which in picked:
        assert set(np.flatnonzero(one.evidence.prior_var)) <= set(which)
    n_first = len(picked[0][1])
    monkeypatch.setattr(weigh_together, "RULES", replace(RULES, most_columns=n_first))
    assert [len(which) for _, which in weigh_together.columns_that_matter(context, fitted, findings)] == [n_first]
    monkeypatch.setattr(weigh_together, "RULES", Rules(most_columns=1))
    assert all(len(which) == 1 for _, which in weigh_together.columns_that_matter(context, fitted, findings))
