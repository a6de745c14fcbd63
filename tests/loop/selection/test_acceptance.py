"""What is tried in which order, what is better, and what is kept."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hydrabeam_mpi.config.effects import Loop
from hydrabeam_mpi.effects.instrument.antenna_delays import AntennaDelays
from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.instrument.antenna_positions import AntennaPositions
from hydrabeam_mpi.effects.instrument.basis_truncation import BasisTruncation
from hydrabeam_mpi.effects.instrument.cross_coupling import CrossCoupling
from hydrabeam_mpi.effects.instrument.timestamp import Timestamp
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.sky.catalogue_flux import CatalogueFlux
from hydrabeam_mpi.effects.sky.horizon import Horizon
from hydrabeam_mpi.effects.sky.missing_sources import MissingSources
from hydrabeam_mpi.fit.state import Active, Fit, Fitted, Values, independent_prior
from hydrabeam_mpi.inference.significance import sigma_of_log_p
from hydrabeam_mpi.loop.attribution.control_models import BeamDrift, ShapeDrift
from hydrabeam_mpi.loop.selection.acceptance import (
    Candidate,
    absorbed_reason,
    improvement,
    in_order,
    indistinguishable,
    is_absorbed,
    is_better,
    is_hopeless,
    may_be_better,
    refusal_of,
    rise_of_rms,
    why_unexplained,
)
from hydrabeam_mpi.loop.selection.heldout_score import fall_significance
from tests.loop.made import N_DATA, blocks, checked, effect_candidate, numbers, round_of, weights_candidate


def ids(cases: list[tuple[Any, ...]]) -> list[str]:
    return [case[0] for case in cases]


ABSORBED = [
    ("up to 95% it is not absorbed", effect_candidate(AntennaGains(), absorbed=0.95), False),
    ("beyond 95% it is", effect_candidate(AntennaGains(), absorbed=0.951), True),
    ("a basis that is too small is about the beam", effect_candidate(BasisTruncation(), absorbed=0.999), False),
    ("weights are nothing that a beam could do", weights_candidate(), False),
]


@pytest.mark.parametrize(("candidate", "absorbed"), [case[1:] for case in ABSORBED], ids=ids(ABSORBED))
def test_is_absorbed(candidate: Candidate, absorbed: bool) -> None:
    assert is_absorbed(candidate) == absorbed


def test_the_reason_says_how_much() -> None:
    reason = absorbed_reason(effect_candidate(AntennaGains(), absorbed=0.9634))
    assert reason == "the beam can absorb 96.3% of it, so that these data cannot tell it from another beam"


HOPELESS = [
    ("what is hardly absorbed has hope whatever its evidence", AntennaGains(), 10.0, 0.9, False),
    ("what is absorbed has none beside what has more evidence", AntennaGains(), 99.0, 0.96, True),
    ("what is absorbed may explain all if it has the most evidence", AntennaGains(), 100.0, 0.96, False),
    ("what is wholly absorbed has none even then", AntennaGains(), 1000.0, 0.991, True),
    ("a basis that is too small always has hope", BasisTruncation(), 10.0, 0.999, False),
]


@pytest.mark.parametrize(
    ("effect", "log_bayes_factor", "absorbed", "hopeless"), [case[1:] for case in HOPELESS], ids=ids(HOPELESS)
)
def test_is_hopeless(effect: Effect, log_bayes_factor: float, absorbed: float, hopeless: bool) -> None:
    candidate = effect_candidate(effect, log_bayes_factor, absorbed)
    assert is_hopeless(candidate, [candidate, effect_candidate(Timestamp(), 100.0)]) == hopeless


ORDERS: list[tuple[str, dict[str, float], int, list[str]]] = [
    ("nothing is wanted", {}, 6, []),
    ("effects by evidence", {"gains": 50, "delays": 40}, 6, ["gains", "delays"]),
    ("noise after effects near it", {"noise": 100, "gains": 50, "delays": 10}, 6, ["gains", "delays", "noise"]),
    ("noise before effects that do not", {"noise": 100, "gains": 50, "delays": 9.9}, 6, ["gains", "noise", "delays"]),
    ("noise alone where no effect comes near", {"noise": 100, "gains": 9}, 6, ["noise", "gains"]),
    ("only so many effects, and noise besides", {"gains": 50, "noise": 45, "delays": 40}, 1, ["gains", "noise"]),
]  # fmt: skip
NAMED = {"gains": AntennaGains(), "delays": AntennaDelays()}


@pytest.mark.parametrize(("wanted", "most", "order"), [case[1:] for case in ORDERS], ids=ids(ORDERS))
def test_the_order_of_trials(wanted: dict[str, float], most: int, order: list[str]) -> None:
    made = {
        name: effect_candidate(NAMED[name], evidence) if name in NAMED else weights_candidate(evidence)
        for name, evidence in wanted.items()
    }
    assert in_order(list(made.values()), most) == [made[name] for name in order]


@pytest.mark.parametrize(
    ("log_bayes_factor", "log_spread", "better"),
    [
        pytest.param(100.0, 0.0, False, id="the same is not better"),
        pytest.param(101.0, 0.0, True, id="more evidence of the fitted data"),
        pytest.param(100.0, -1.0, True, id="a greater density of the held-out data"),
        pytest.param(90.0, -11.0, True, id="less of the one and more of the other"),
        pytest.param(110.0, 11.0, False, id="more of the one and less of the other"),
        pytest.param(np.nan, -100.0, False, id="no number at all"),
    ],
)
def test_better_is_by_the_evidence_of_all_data(log_bayes_factor: float, log_spread: float, better: bool) -> None:
    best = round_of(effect_candidate(AntennaGains(), 100.0), checked(2.0), checked(1.2))
    fitted = effect_candidate(AntennaDelays(), log_bayes_factor)
    assert is_better(fitted, checked(1.2, log_spread), best) == better


MAY_BE = [
    ("a change of the weights is no better than a structure", weights_candidate(1e4), False, False),
    ("a nonlinear one with a tenth of the evidence", effect_candidate(AntennaPositions(), 10.0), False, True),
    ("a nonlinear one with less", effect_candidate(AntennaPositions(), 9.9), False, False),
    ("a linear one with seven tenths", effect_candidate(AntennaGains(), 70.0), False, True),
    ("a linear one with less", effect_candidate(AntennaGains(), 69.0), False, False),
    ("a simpler one where nothing is left", effect_candidate(Timestamp(), 20.0, effective=1.0), True, True),
    ("no simpler one where nothing is left", effect_candidate(AntennaPositions(), 90.0, effective=2.0), True, False),
    ("one whose places are refined only then", effect_candidate(MissingSources(), 71.0, effective=9.0), True, True),
    ("one of these with too little evidence", effect_candidate(MissingSources(), 70.0, effective=9.0), True, False),
    ("one that is scanned but linear", effect_candidate(CrossCoupling(), 90.0, effective=9.0), True, False),
]


@pytest.mark.parametrize(("candidate", "enough", "may"), [case[1:] for case in MAY_BE], ids=ids(MAY_BE))
def test_what_may_be_better_once_it_is_fitted(candidate: Candidate, enough: bool, may: bool) -> None:
    best = round_of(effect_candidate(NAMED["gains"], 100.0, effective=2.0), checked(2.0), checked(1.2))
    assert may_be_better(candidate, best, enough) == may


def test_everything_linear_says_so() -> None:
    """The table above takes these for what they are."""
    assert AntennaGains().linear
    assert CrossCoupling().linear
    assert not AntennaPositions().linear
    assert not MissingSources().linear


def test_weights_are_better_by_how_much_nearer_chi2_is() -> None:
    assert improvement(checked(2.0), checked(1.0), weights_candidate()) == pytest.approx(np.sqrt(N_DATA))
    assert improvement(checked(0.5), checked(1.0), weights_candidate()) == pytest.approx(0.5 * np.sqrt(N_DATA))


@pytest.mark.parametrize("chi2", [1.5, 1.11, 1.1, 1.05])
def test_effects_are_better_by_blocks_or_where_little_is_left_by_densities(chi2: float) -> None:
    before, after = checked(1.6), replace(checked(chi2), score=blocks(chi2, -4000.0, seed=2))
    by_blocks = fall_significance(before.score, after.score)
    by_density = sigma_of_log_p(before.score.log_density - after.score.log_density)
    assert by_density > by_blocks
    found = improvement(before, after, effect_candidate(AntennaGains()))
    assert found == pytest.approx(by_density if chi2 <= 1.1 else by_blocks)


def fit(**given: Any) -> dict[str, Any]:
    """What is accepted, but for what is given."""
    usual = {"lbf": 50.0, "tried": 0.1, "fitted": 0.1, "effect": AntennaGains(), "sigma": 10.0}
    return {**usual, "before": checked(2.0), "after": {"chi2": 1.2}, **given}


WALL = Horizon([(0, 90, 0, 5)])
REFUSALS: list[tuple[str, dict[str, Any], str | None]] = [
    ("all is well", fit(), None),
    ("as little evidence as is asked for", fit(lbf=5.0), None),
    ("less evidence once it is fitted", fit(lbf=4.9), "its log Bayes factor is 4.9 once it is fitted"),
    ("evidence that is no number", fit(lbf=np.nan), "its log Bayes factor is nan once it is fitted"),
    ("absorbed before it was fitted", fit(tried=0.96), "the beam can absorb 96.0% of it"),
    ("absorbed, but it explains everything", fit(tried=0.96, after={"chi2": 1.0, "consistent": True}), None),
    ("nearly absorbed, and then wholly", fit(tried=0.91, fitted=0.97), "the beam can absorb 97.0% of it"),
    ("nearly absorbed, and then not more", fit(tried=0.91, fitted=0.94), None),
    ("absorbed only where it has been fitted", fit(tried=0.89, fitted=0.97), None),
    ("a basis too small, of which the beam has all", fit(tried=0.99, fitted=0.99, effect=BasisTruncation()), None),
    ("walls that hide sources", fit(effect=WALL, x=-0.3), None),
    ("walls that make them brighter", fit(effect=WALL, x=0.3), "sources behind it would be brighter"),
    ("predictions wider than errors", fit(after={"chi2": 0.69}), "it is so uncertain that it predicts nothing"),
    ("chi2 that rises", fit(after={"chi2": 2.1}), "held-out chi^2 does not fall: 2 to 2.1"),
    ("chi2 that is no number", fit(after={"chi2": np.nan}), "held-out chi^2 does not fall"),
    ("wider rather than nearer", fit(after={"chi2": 1.9, "log_spread": 200.0}), "wider rather than nearer"),
    ("plain residuals that rise", fit(after={"chi2": 1.2, "rms": 2.0}), "rises from 1.414 to 2 Jy, by more than its"),
    ("plain residuals that stay", fit(after={"chi2": 1.2, "rms": 2.0**0.5}), None),
    ("a fall that may be chance", fit(sigma=2.9), "held-out chi^2 falls by 2.9 sigma only, 2 to 1.2"),
]  # fmt: skip


@pytest.mark.parametrize(("given", "words"), [case[1:] for case in REFUSALS], ids=ids(REFUSALS))
def test_effects_are_kept_or_refused(given: dict[str, Any], words: str | None) -> None:
    effect = given["effect"]
    x, std = np.full((1, 1), given.get("x", 0.1)), np.full((1, 1), 0.01)
    found = Fitted(
        Values((Active(effect, *independent_prior(np.ones(1), effect.shared), x, np.ones(1), np.zeros((0, 1))),)),
        Fit(std=(std,)),
    )
    tried, fitted = (effect_candidate(effect, given["lbf"], given[which]) for which in ("tried", "fitted"))
    after = checked(**given["after"], fitted=found)
    reason = refusal_of(given["before"], after, tried, fitted, given["sigma"], Loop())
    assert reason is None if words is None else words in str(reason)


OF_WEIGHTS: list[tuple[str, float, dict[str, Any], float, str | None]] = [
    ("chi2 nearer to one from above", 2.0, {"chi2": 1.1, "white": True}, 50.0, None),
    ("chi2 nearer to one from below", 0.5, {"chi2": 0.9, "white": True}, 50.0, None),
    ("chi2 on the other side, farther", 1.2, {"chi2": 0.7, "white": True}, 50.0, "held-out chi^2 goes from 1.2 to 0.7"),
    ("what is left has a structure", 2.0, {"chi2": 1.1}, 50.0, "what is left is not white: its times differ"),
    ("too little evidence", 2.0, {"chi2": 1.1, "white": True}, 4.0, "its log Bayes factor is 4 once it is fitted"),
]  # fmt: skip


@pytest.mark.parametrize(("before", "after", "lbf", "words"), [one[1:] for one in OF_WEIGHTS], ids=ids(OF_WEIGHTS))
def test_weights_are_kept_or_refused(before: float, after: dict[str, Any], lbf: float, words: str | None) -> None:
    """Whatever the significance, which is that of noise."""
    candidate = weights_candidate(lbf)
    reason = refusal_of(checked(before), checked(**after), candidate, candidate, 0.0, Loop())
    assert reason is None if words is None else words in str(reason)


def test_a_change_of_weights_is_not_asked_for_nearer_predictions() -> None:
    candidate, after = weights_candidate(50.0), checked(1.1, white=True, rms=1.5)
    assert rise_of_rms(checked(2.0), after) is not None
    assert refusal_of(checked(2.0), after, candidate, candidate, 0.0, Loop()) is None


RISES = [
    pytest.param(3.0, 3.0, False, id="the same"),
    pytest.param(3.0, 2.9, False, id="a fall"),
    pytest.param(3.0, 3.01, False, id="a rise within the scatter of its blocks"),
    pytest.param(3.0, 3.3, True, id="a rise beyond it"),
]


@pytest.mark.parametrize(("one", "two", "rises"), RISES)
def test_residuals_rise_beyond_their_error(one: float, two: float, rises: bool) -> None:
    """Whatever chi^2 under the predictive says, whose falls may come from wider predictions."""
    after = replace(checked(1.0), numbers=numbers(two, expected=two, seed=4))
    said = rise_of_rms(checked(5.0, rms=one), after)
    assert (said is not None) == rises
    if rises:
        assert said == (
            "the rms of the held-out residual rises from 3 to 3.3 Jy, by more than its error "
            "(noise 1 Jy, the data 10 Jy)"
        )


CONTROL = round_of(effect_candidate(BeamDrift()), checked(2.0), checked(1.2))
WHY: list[tuple[str, dict[str, Any], bool, str | None]] = [
    ("calibrated and at the noise", {"chi2": 1.0, "consistent": True}, False, None),
    ("not calibrated", {"chi2": 4.0}, False, "not calibrated: what is left is more than they expect (predictive"),
    ("calibrated as they are wide", {"chi2": 1.0, "consistent": True, "rms": 3.0}, False,
     "calibrated, but only as they are wide: the held-out residual has 3 Jy rms, where the noise has 1 Jy"),
    ("calibrated, and as wide as data leave the beam", {"chi2": 1.0, "consistent": True, "rms": 3.0, "expected": 3.0},
     False, None),
    ("a control model", {"chi2": 1.0, "consistent": True}, True, "a beam that changes in time would explain more"),
]  # fmt: skip


@pytest.mark.parametrize(("given", "control", "words"), [case[1:] for case in WHY], ids=ids(WHY))
def test_why_data_stay_unexplained(given: dict[str, Any], control: bool, words: str | None) -> None:
    why = why_unexplained(checked(**given), CONTROL if control else None)
    assert why is None if words is None else words in str(why)


def test_the_thresholds_are_the_jobs() -> None:
    candidate = effect_candidate(AntennaGains(), 8.0)
    active = Active(AntennaGains(), *independent_prior(np.ones(1), shared=False), *np.ones((2, 1)), np.zeros((0, 1)))
    found = Fitted(Values((active,)), Fit(std=(np.ones((1, 1)),)))
    given = (checked(2.0), checked(1.2, fitted=found), candidate, candidate, 4.0)
    assert refusal_of(*given, Loop()) is None
    assert "log Bayes factor" in str(refusal_of(*given, Loop(min_log_bayes_factor=8.5)))
    assert "4.0 sigma only" in str(refusal_of(*given, Loop(min_heldout_sigma=4.5)))


def test_what_explains_as_much_is_named() -> None:
    """Within five nats, by the evidence of the candidate once it is fitted; more is as much as well."""
    others = {AntennaDelays(): 95.1, AntennaPositions(): 95.0, Timestamp(): 20.0, CatalogueFlux(): 300.0}
    ranking = [effect_candidate(effect, evidence) for effect, evidence in others.items()]
    chosen = effect_candidate(AntennaGains(), 100.0)
    ranking += [effect_candidate(AntennaGains(), 99.0), weights_candidate(98.0)]
    assert indistinguishable(chosen, ranking) == ["antenna_delays", "catalogue_flux", "noise_level"]
    assert indistinguishable(chosen, []) == []


def test_a_beam_that_drifts_is_no_effect() -> None:
    assert effect_candidate(BeamDrift()).is_control
    assert effect_candidate(ShapeDrift()).is_control
    assert not effect_candidate(AntennaGains()).is_control
    assert not weights_candidate().is_control
