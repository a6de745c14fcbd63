"""What may be tried: each effect by itself, and those that explain the residual together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.instrument.antenna_positions import AntennaPositions
from hydrabeam_mpi.effects.instrument.closure_errors import ClosureErrors
from hydrabeam_mpi.effects.instrument.cross_coupling import CrossCoupling
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.noise.bad_baselines import BadBaselines
from hydrabeam_mpi.effects.registry import laws_of
from hydrabeam_mpi.effects.sky.missing_sources import MissingSources
from hydrabeam_mpi.effects.sky.moving_sources import MovingSources
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.state import Active, Fitted, Values
from hydrabeam_mpi.loop.attribution import columns_that_matter
from hydrabeam_mpi.loop.rules import RULES
from hydrabeam_mpi.loop.selection.acceptance import Candidate, Checked, Round
from hydrabeam_mpi.loop.selection.predictions import check
from hydrabeam_mpi.loop.selection.trials import may_be_tried, try_effects
from hydrabeam_mpi.loop.selection.weighing import Outlook, Together, Weighed, weigh
from hydrabeam_mpi.loop.selection.whole_set import try_set
from tests.loop.made import checked, effect_candidate, round_of, weights_candidate
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


@pytest.fixture(scope="module")
def found(context: FitContext, weighed: Weighed) -> tuple[Round, Round]:
    """A gain, and a coupling after it."""
    gains, coupling = weighed.together.members
    first = try_effects(context, check(context, refit(context, Values())), [gains], [])
    assert first is not None
    second = try_effects(context, first.after, [coupling], [])
    assert second is not None
    return first, second


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


def test_no_more_effects_than_may_be_added(context: FitContext, weighed: Weighed) -> None:
    fitted = refit(context, Values())
    assert len(weighed.together.members) == 2
    assert [one.kind for one in weigh(context, fitted, EFFECTS, [], 1).together.members] == ["antenna_gains"]
    assert weigh(context, fitted, EFFECTS, [], 0).together.members == ()


def test_what_competes_with_a_member_is_told_beside_the_others(weighed: Weighed) -> None:
    for member, beside in zip(weighed.together.members, weighed.together.beside, strict=True):
        assert weighed.together.in_place_of(replace(member, log_bayes_factor=0.0)) is beside
        assert member in beside


def test_columns_are_those_in_use_and_further_ones_that_gain_alone(
    context: FitContext, weighed: Weighed, monkeypatch: pytest.MonkeyPatch
) -> None:
    fitted = refit(context, Values())
    findings = [one.finding for one in weighed.ranking if one.finding is not None]
    picked = columns_that_matter.columns_that_matter(context, fitted, findings)
    assert [one for one, _ in picked] == findings
    assert all(columns_that_matter.has_all_in_use(one, which) for one, which in picked)
    # With little room each effect has its part of it, for the elements that gain most alone.
    room = sum(len(which) for _, which in picked) // 2
    monkeypatch.setattr(columns_that_matter, "RULES", replace(RULES, most_columns=room))
    fewer = columns_that_matter.columns_that_matter(context, fitted, findings)
    assert [one for one, _ in fewer] == findings
    assert sum(len(which) for _, which in fewer) <= room
    cut = [one for one in zip(fewer, picked, strict=True) if not columns_that_matter.has_all_in_use(*one[0])]
    assert cut
    for (one, which), (_, before) in cut:
        assert one.evidence.alone[which].min() >= one.evidence.alone[np.setdiff1d(before, which)].max()


def test_no_set_is_told_of_what_explains_less_than_is_left(tmp_path: Path) -> None:
    """Gains and positions take up parts of a strong coupling that is not among what is looked for."""
    strong = COUPLED | {"parameters": {"baseline 1-4 real": 0.05}}
    context = context_of(mock_job(strong), tmp_path)
    fitted, effects = refit(context, Values()), [AntennaGains(), AntennaPositions()]
    found = weigh(context, fitted, effects, [], 6)
    assert min(one.log_bayes_factor for one in found.ranking) > 100 * context.problem.job.loop.min_log_bayes_factor
    assert found == Weighed(found.ranking)
    # With the coupling beside them that is what explains the data.
    found = weigh(context, fitted, [*effects, *EFFECTS[1:]], [], 6)
    assert found.explains
    assert [one.kind for one in found.together.members] == ["cross_coupling"]


def test_a_constant_effect_and_its_drift_are_tried_together_beside_what_none_explains(tmp_path: Path) -> None:
    """By itself either leaves what the other explains, so that jumps, which stand for both, explain more."""
    drift, curvature = "antenna 2 phase, drift from first to last time", "antenna 4 phase, curvature, ends less middle"
    injected = (
        {"kind": "antenna_gains", "parameters": {"antenna 2 phase": 0.03, "antenna 4 phase": -0.03}},
        {
            "kind": "antenna_gains",
            "settings": {"law": "smooth", "orders": [1, 2]},
            "parameters": {drift: 0.06, curvature: 0.06},
        },
        COUPLED | {"parameters": {"baseline 1-4 real": 0.001}},
    )
    context = context_of(mock_job(*injected, n_times=24), tmp_path)
    before = check(context, refit(context, Values()))
    laws = [one for one in laws_of("antenna_gains") if one.not_applicable(context.setup) is None]
    found = weigh(context, before.fitted, laws, [], 6)
    assert found.ranking[0].law == "piecewise"
    assert not found.explains
    assert {one.law for one in found.with_drift.members} == {"constant", "smooth"}
    assert found.with_drift.log_bayes_factor > found.ranking[0].log_bayes_factor
    rounds = try_set(context, before, found, [])
    assert {one.candidate.law for one in rounds} == {"constant", "smooth"}
    # What explains all that there is is told as a set of effects.
    found = weigh(context, before.fitted, [*laws, *EFFECTS[1:]], [], 6)
    assert found.explains
    assert found.with_drift == Together()
    assert weigh(context, before.fitted, laws, [], 1).with_drift == Together()


def test_what_is_linear_has_to_come_to_more_than_the_best_with_what_is_beside_it(
    context: FitContext, weighed: Weighed
) -> None:
    """Many factors might stand for a gain and for a coupling, and come to more than either of them."""
    effects = [*EFFECTS, CrossCoupling([[1, 4], [0, 5]])]
    checked = check(context, refit(context, Values()))
    gains, closure = (one for one in weighed.ranking if one.kind in {"antenna_gains", "closure_errors"})
    best = try_effects(context, checked, [gains], [])
    assert best is not None
    outlook = Outlook(context, effects, [], 6, weighed)
    both = outlook.with_rest(best)
    assert both is not None
    assert outlook.ahead is not None
    (rest,) = outlook.ahead[1].together.members
    first, second = best.candidate.log_bayes_factor, rest.log_bayes_factor
    assert both.candidate.log_bayes_factor == pytest.approx(first + second)
    assert closure.finding is not None
    assert closure.finding.effect.linear
    many = replace(closure.finding, evidence=replace(closure.finding.evidence, effective_parameters=12.0))
    for part, is_tried in ((0.5, False), (1.5, True)):
        other = replace(closure, finding=many, log_bayes_factor=first + part * second)
        assert may_be_tried(context, other, best, outlook) is is_tried
        assert may_be_tried(context, other, best, None)


def test_what_is_simpler_leads_further_if_with_another_it_has_more_than_the_best_can_come_to(
    context: FitContext, weighed: Weighed, found: tuple[Round, Round]
) -> None:
    """What has many parameters may explain a gain and a coupling, and so come before either of them."""
    (gains, _), (simpler, both) = weighed.together.members, found
    first, second = simpler.candidate.log_bayes_factor, both.candidate.log_bayes_factor
    assert gains.finding is not None

    def of_both(less: float, n_parameters: float = 40.0) -> Round:
        """With so much less evidence than a gain and a coupling one after the other."""
        assert gains.finding is not None
        evidence = replace(gains.finding.evidence, effective_parameters=n_parameters)
        candidate = replace(gains, finding=replace(gains.finding, evidence=evidence))
        return replace(both, candidate=replace(candidate, log_bayes_factor=first + second - less))

    given = simpler.candidate, simpler.after
    outlook = Outlook(context, EFFECTS, [], 6, weighed)
    beside = outlook.leads_further(*given, of_both(60.0))
    assert beside is not None
    assert not outlook.leads
    outlook.follow(simpler, beside)
    assert outlook.leads
    assert outlook.explains_rest(simpler)
    assert outlook.after(simpler.after.fitted) is beside
    with_rest = outlook.with_rest(simpler)
    assert with_rest is not None
    assert with_rest.candidate.log_bayes_factor == pytest.approx(first + second, abs=10.0)
    # Nothing stands in for the coupling; what explains both has as much evidence; or fewer parameters.
    for effects, best in (
        (EFFECTS[:1], of_both(60.0)),
        (EFFECTS, of_both(-20.0)),
        (EFFECTS, of_both(60.0, n_parameters=1.0)),
    ):
        assert Outlook(context, effects, [], 6, weighed).leads_further(*given, best) is None
    # What leaves rows out explains nothing that others could go on from.
    outlook = Outlook(context, EFFECTS, [], 6, weighed)
    assert outlook.leads_further(weights_candidate(), simpler.after, of_both(60.0)) is None


def test_what_is_simpler_stays_the_best_if_with_another_it_comes_to_more(
    context: FitContext, weighed: Weighed, found: tuple[Round, Round]
) -> None:
    """What has many parameters is fitted after a gain, and has more evidence than that has without a coupling."""
    (gains, _), (best, both) = weighed.together.members, found
    assert gains.finding is not None
    evidence = replace(gains.finding.evidence, effective_parameters=40.0)
    many, second = replace(gains, finding=replace(gains.finding, evidence=evidence)), both.candidate.log_bayes_factor

    def is_led(effects: Sequence[Effect], more: float, after: Checked, rival: Candidate = many) -> bool:
        """Whether the gains lead something that has so much more evidence than they have."""
        rival = replace(rival, log_bayes_factor=best.candidate.log_bayes_factor + more)
        outlook = Outlook(context, effects, [], 6, weighed)
        led = outlook.is_led_by(best, rival, after)
        if not led and outlook.ahead is not None and outlook.ahead[0] is after.fitted:
            # It is going to be the best, and what there is beside it has been weighed.
            assert outlook.after(after.fitted) is outlook.ahead[1]
        return led

    assert is_led(EFFECTS, 0.5 * second, both.after)
    assert not is_led(EFFECTS, 1.5 * second, both.after)
    # Nothing stands in for the coupling, or what is not simpler.
    assert not is_led(EFFECTS[:1], 0.5 * second, both.after)
    assert not is_led(EFFECTS, 0.5 * second, both.after, gains)
    # Beside the other the coupling is wanted as well.
    assert not is_led(EFFECTS, 0.5 * second, best.after)


def test_baselines_are_left_out_only_where_some_are_bad_beside_the_best(
    context: FitContext, weighed: Weighed, found: tuple[Round, Round]
) -> None:
    best, weights = found[0], weights_candidate(1e9).weights
    assert weights is not None
    bad = Candidate(BadBaselines.kind, BadBaselines.title, 1e9, weights=replace(weights, change=BadBaselines()))
    assert bad.is_of_unknown
    least = context.problem.job.loop.min_log_bayes_factor
    for beside, is_tried in ((2 * least, True), (0.5 * least, False), (None, False)):
        ranking = () if beside is None else (replace(bad, log_bayes_factor=beside),)
        outlook = Outlook(context, EFFECTS, [], 6, weighed, (best.after.fitted, Weighed(ranking)))
        assert may_be_tried(context, bad, best, outlook) is is_tried
    # What is known of another one says nothing of the best.
    outlook = Outlook(context, EFFECTS, [], 6, weighed, (Fitted(), Weighed((replace(bad, log_bayes_factor=1e6),))))
    assert outlook.beside(best, bad) == 0.0
    assert outlook.after(best.after.fitted) is not None


def test_what_moves_is_a_rival_of_several_that_stay_but_not_of_one(context: FitContext) -> None:
    places = [(31.4, -28.6), (40.0, -25.0)]
    stays, moves = MissingSources(places), MovingSources(places).in_full(context.setup)
    parameters = stays.parameters(context.setup)
    for wanted, is_tried in ([0], False), ([0, 1], True):
        prior_var = np.where(np.isin(parameters.element, wanted), parameters.scale**2, 0.0)
        active = Active.start(stays, context.setup, prior_var, np.zeros((1, len(prior_var))))
        after = checked(1.0, fitted=Fitted(Values((active,))))
        best = round_of(effect_candidate(stays, 100.0), checked(5.0), after)
        assert may_be_tried(context, effect_candidate(moves, 90.0), best, None) is is_tried
        assert may_be_tried(context, effect_candidate(moves, 110.0), best, None)
