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
from hydrabeam_mpi.effects.registry import make_effect
from hydrabeam_mpi.effects.sky.catalogue_flux import CatalogueFlux
from hydrabeam_mpi.effects.sky.missing_sources import MissingSources
from hydrabeam_mpi.fit.state import Active, Fit, Fitted, Values, independent_prior
from hydrabeam_mpi.inference.significance import sigma_of_log_p
from hydrabeam_mpi.loop.attribution.constancy import Constancy
from hydrabeam_mpi.loop.attribution.control_models import BeamDrift, ShapeDrift
from hydrabeam_mpi.loop.selection.acceptance import (
    Candidate,
    improvement,
    in_order,
    indistinguishable,
    is_better,
    may_be_better,
    refusal_beside,
    refusal_by_parts,
    refusal_of,
    rise_of_rms,
    rivals_of,
    why_unexplained,
)
from hydrabeam_mpi.loop.selection.heldout_score import fall_significance
from tests.loop.made import N_DATA, blocks, checked, effect_candidate, numbers, round_of, weights_candidate

LOOP = Loop()


def ids(cases: list[tuple[Any, ...]]) -> list[str]:
    return [case[0] for case in cases]


ORDERS: list[tuple[str, dict[str, float], int, list[str]]] = [
    ("nothing is wanted", {}, 6, []),
    ("effects by evidence", {"gains": 50, "delays": 40}, 6, ["gains", "delays"]),
    ("noise after effects near it", {"noise": 100, "gains": 50, "delays": 10}, 6, ["gains", "delays", "noise"]),
    ("noise before effects that do not", {"noise": 100, "gains": 50, "delays": 9.9}, 6, ["gains", "noise", "delays"]),
    ("noise alone where no effect comes near", {"noise": 100, "gains": 9}, 6, ["noise", "gains"]),
    ("linear ones that come near first", {"places": 60, "delays": 50, "gains": 42}, 6, ["gains", "places", "delays"]),
    ("others that are linear later", {"places": 61, "gains": 42}, 6, ["places", "gains"]),
    ("only so many effects, and noise besides", {"gains": 50, "noise": 45, "delays": 40}, 1, ["gains", "noise"]),
]  # fmt: skip
NAMED = {"gains": AntennaGains(), "delays": AntennaDelays(), "places": AntennaPositions()}


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
    ("one with more evidence, which was tried later", effect_candidate(AntennaPositions(), 101.0), True, True),
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


def fit(**given: Any) -> dict[str, Any]:
    """What is accepted, but for what is given."""
    usual = {"lbf": 50.0, "absorbed": 0.1, "effect": AntennaGains(), "converged": True}
    return {**usual, "before": checked(2.0), "after": {"chi2": 1.2}, **given}


def judged(given: dict[str, Any], settings: Loop = LOOP) -> str | None:
    effect = given["effect"]
    x, std = np.full((1, 1), given.get("x", 0.1)), np.full((1, 1), 0.01)
    found = Fitted(
        Values((Active(effect, *independent_prior(np.ones(1), effect.shared), x, np.ones(1), np.zeros((0, 1))),)),
        Fit(std=(std,)),
    )
    after = checked(**given["after"], fitted=found)
    diagnostics = replace(after.fitted.diagnostics, converged=given["converged"])
    after = replace(after, fitted=replace(after.fitted, diagnostics=diagnostics))
    return refusal_of(given["before"], after, effect_candidate(effect, given["lbf"], given["absorbed"]), settings)


WIDER = N_DATA * np.log(2 / 1.9)
"""ln det by which a fall of chi^2 from 2 to 1.9 is bought."""
NO_BETTER = "held-out data are predicted no better: ln of their density changes by"
NOTHING_TOLD = "its fit did not converge, which says nothing for or against it"
REFUSALS: list[tuple[str, dict[str, Any], str | None]] = [
    ("all is well", fit(), None),
    ("as little evidence as is asked for", fit(lbf=5.0), None),
    ("less evidence once it is fitted", fit(lbf=4.9), "its log Bayes factor is 4.9 once it is fitted"),
    ("evidence that is no number", fit(lbf=np.nan), "its log Bayes factor is nan once it is fitted"),
    ("absorbed nearly wholly, which decides nothing", fit(absorbed=0.9999), None),
    ("a basis too small, of which the beam has all", fit(absorbed=0.99, effect=BasisTruncation()), None),
    ("chi2 that rises", fit(after={"chi2": 2.1, "rms": 1.4}), f"{NO_BETTER} -97.58, chi^2 from 2 to 2.1"),
    ("chi2 that is no number", fit(after={"chi2": np.nan, "rms": 1.4}), f"{NO_BETTER} nan"),
    ("wider rather than nearer", fit(after={"chi2": 1.9, "log_spread": WIDER}), NO_BETTER),
    ("nearer by what is asked for", fit(after={"chi2": 1.9, "log_spread": WIDER - 5.1}), None),
    ("nearer by less", fit(after={"chi2": 1.9, "log_spread": WIDER - 4.9}), NO_BETTER),
    ("so wide that errors are smaller", fit(after={"chi2": 0.3, "log_spread": 4000.0}), f"{NO_BETTER} -1214"),
    ("plain residuals that rise", fit(after={"chi2": 1.2, "rms": 2.0}), "rises from 1.414 to 2 Jy, by more than its"),
    ("plain residuals that stay", fit(after={"chi2": 1.2, "rms": 2.0**0.5}), None),
    ("not converged, but it predicts all the same", fit(converged=False), None),
    ("not converged, without evidence", fit(converged=False, lbf=-1e5), NOTHING_TOLD),
    ("not converged, and predicting worse", fit(converged=False, after={"chi2": 2.1, "rms": 1.4}), NOTHING_TOLD),
]  # fmt: skip


@pytest.mark.parametrize(("given", "words"), [case[1:] for case in REFUSALS], ids=ids(REFUSALS))
def test_effects_are_kept_or_refused(given: dict[str, Any], words: str | None) -> None:
    reason = judged(given)
    assert reason is None if words is None else words in str(reason)


def test_few_data_need_no_scatter_between_blocks() -> None:
    """Of two times and groups there is none, and what predicts them better by far is kept."""
    few = [replace(one, times=one.times[:, :2], groups=one.groups[:, :2]) for one in (blocks(40.0), blocks(2.0))]
    before, after = (replace(checked(one.chi2), score=one) for one in few)
    assert fall_significance(before.score, after.score) == 0
    assert improvement(before, after, effect_candidate(AntennaGains())) > 20


@pytest.mark.parametrize("chi2", [1.6, 1.3, 1.0, 0.9])
def test_the_significance_is_that_of_blocks_or_of_densities(chi2: float) -> None:
    """By densities a ratio of e^k has a probability of e^-k at most."""
    before, after = checked(1.7), replace(checked(chi2), score=blocks(chi2, seed=2))
    by_blocks = fall_significance(before.score, after.score)
    by_density = sigma_of_log_p(before.score.log_density_at_own_level - after.score.log_density_at_own_level)
    assert improvement(before, after, effect_candidate(AntennaGains())) == max(by_blocks, by_density)


RIVALS: list[tuple[str, Candidate, list[str]]] = [
    ("what has less evidence than a drift must hold beside it", effect_candidate(CatalogueFlux(), 100.0), ["drift"]),
    ("as what has hardly more", effect_candidate(CatalogueFlux(), 304.9), ["drift"]),
    ("what has more evidence is the better explanation", effect_candidate(CatalogueFlux(), 305.0), []),
    ("beside more modes too where they have as much", effect_candidate(CatalogueFlux(), 50.0), ["drift", "basis"]),
    ("more modes have to be told from a drift", effect_candidate(BasisTruncation(), 60.0), ["drift"]),
    ("weights say nothing of the beam", weights_candidate(50.0), []),
]


@pytest.mark.parametrize(("candidate", "rivals"), [case[1:] for case in RIVALS], ids=ids(RIVALS))
def test_what_an_effect_must_be_told_from(candidate: Candidate, rivals: list[str]) -> None:
    """Faults of the beam's model, of which it is never sure that they are not there."""
    named = {"drift": effect_candidate(BeamDrift(), 300.0), "basis": effect_candidate(BasisTruncation(), 60.0)}
    ranking = [named["drift"], effect_candidate(AntennaGains(), 200.0), named["basis"], weights_candidate(400.0)]
    assert rivals_of(candidate, ranking, LOOP) == [named[name] for name in rivals]


def test_an_effect_is_refused_where_nothing_of_it_is_left_beside_a_rival() -> None:
    drift = effect_candidate(BeamDrift(), 314.0)
    assert refusal_beside(drift, 5.0, LOOP) is None
    assert refusal_beside(drift, -5.104, LOOP) == (
        "a beam that changes in time explains as much (ln BF 314), and beside that its log Bayes factor is -5.104"
    )


OF_WEIGHTS: list[tuple[str, float, dict[str, Any], float, str | None]] = [
    ("chi2 nearer to one from above", 2.0, {"chi2": 1.1, "white": True}, 50.0, None),
    ("chi2 nearer to one from below", 0.5, {"chi2": 0.9, "white": True}, 50.0, None),
    ("chi2 on the other side, farther", 1.2, {"chi2": 0.7, "white": True}, 50.0, "held-out chi^2 goes from 1.2 to 0.7"),
    ("what is left has a structure", 2.0, {"chi2": 1.1}, 50.0, "what is left is not white: its times differ"),
    ("too little evidence", 2.0, {"chi2": 1.1, "white": True}, 4.0, "its log Bayes factor is 4 once it is fitted"),
]  # fmt: skip


@pytest.mark.parametrize(("before", "after", "lbf", "words"), [one[1:] for one in OF_WEIGHTS], ids=ids(OF_WEIGHTS))
def test_weights_are_kept_or_refused(before: float, after: dict[str, Any], lbf: float, words: str | None) -> None:
    reason = refusal_of(checked(before), checked(**after), weights_candidate(lbf), LOOP)
    assert reason is None if words is None else words in str(reason)


def test_a_change_of_weights_is_not_asked_for_nearer_predictions() -> None:
    candidate, after = weights_candidate(50.0), checked(1.1, white=True, rms=1.5)
    assert rise_of_rms(checked(2.0), after) is not None
    assert refusal_of(checked(2.0), after, candidate, LOOP) is None


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


PARTS: list[tuple[str, list[tuple[str, float, float]], str | None]] = [
    ("nobody can ask", [], None),
    ("the same in all", [("times", 19.8, 20.4), ("baselines", 23.3, 21.0)], None),
    ("as little as expected, as few parts tell it", [("times", 4.0, 4.2), ("baselines", 0.0, 0.0)], None),
    ("less than expected, and both are little", [("times", 1.0, 5.9)], None),
    ("less by what noise does", [("times", 4.9, 9.8)], None),
    ("less by more than that", [("times", 4.9, 10.0)], "between times"),
    ("little where more is expected", [("times", 1.0, 6.1)], "between times"),
    ("one that spreads beside another effect", [("times", 5.1, 800.0)], None),
    ("none where none is expected", [("times", -61.2, -48.2)], None),
    ("times differ", [("times", -14.9, 785.8), ("baselines", 0.0, 0.0)], "between times"),
    ("baselines differ", [("times", 91.0, 92.0), ("baselines", -0.4, 69.2)], "between baselines"),
]


@pytest.mark.parametrize(("found", "words"), [case[1:] for case in PARTS], ids=ids(PARTS))
def test_an_effect_is_the_same_in_all_parts(found: list[tuple[str, float, float]], words: str | None) -> None:
    said = refusal_by_parts([Constancy(*one, spread=2.6, expected_by_noise=one[-1]) for one in found], LOOP)
    assert said is None if words is None else words in str(said)


def test_what_cannot_be_told_from_what_is_left_is_not_claimed() -> None:
    """Where noise alone would leave it enough evidence; else the answer says nothing."""
    said = refusal_by_parts([Constancy("times", -2.0, -1.2, 39.2, expected_by_noise=153.8)], LOOP)
    assert said == (
        "it cannot be told from what is left beside it: with errors as large as that makes them, ln BF -1.2 is "
        "expected of a common part between times even if it has one, where by noise alone 154 were"
    )
    assert refusal_by_parts([Constancy("times", -2.0, -1.2, 39.2, expected_by_noise=4.0)], LOOP) is None
    assert refusal_by_parts([Constancy("times", 4.6, 4.9, 0.0, expected_by_noise=25.9)], LOOP) is None


def test_how_parts_differ_is_told_in_numbers() -> None:
    assert refusal_by_parts([Constancy("times", -1.534, 54.26, 2.63, 54.26)], LOOP) == (
        "it is not the same in all parts of the data: its parameters differ between times by 2.6 times what they have "
        "in common (ln BF that they have a common part -1.53, where 54.3 is expected of what is the same in all)"
    )
    assert refusal_by_parts([Constancy("times", 8.0, 54.0, 2.6, 54.0)], Loop(min_log_bayes_factor=8.5)) is not None


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


def test_the_threshold_is_the_jobs() -> None:
    """For the evidence of the fitted data and for the density of those held out."""
    assert "log Bayes factor" in str(judged(fit(lbf=8.0), Loop(min_log_bayes_factor=8.5)))
    faint = fit(after={"chi2": 1.9, "log_spread": WIDER - 8.0})
    assert judged(faint) is None
    assert NO_BETTER in str(judged(faint, Loop(min_log_bayes_factor=8.5)))


def test_what_explains_as_much_is_named() -> None:
    """Within five nats, by the evidence of the candidate once it is fitted; more is as much as well."""
    others = {AntennaDelays(): 95.1, AntennaPositions(): 95.0, Timestamp(): 20.0, CatalogueFlux(): 300.0}
    ranking = [effect_candidate(effect, evidence) for effect, evidence in others.items()]
    chosen = effect_candidate(AntennaGains(), 100.0)
    ranking += [effect_candidate(AntennaGains(), 99.0), weights_candidate(98.0)]
    ranking += [effect_candidate(make_effect("antenna_gains", {"law": "smooth"}), 99.5)]
    as_good = [("antenna_delays", "constant"), ("catalogue_flux", "constant"), ("noise_level", None)]
    as_good += [("antenna_gains", "smooth")]
    assert [one.name for one in indistinguishable(chosen, ranking, LOOP)] == as_good
    few = [("catalogue_flux", "constant"), ("antenna_gains", "smooth")]
    assert [one.name for one in indistinguishable(chosen, ranking, Loop(min_log_bayes_factor=1.0))] == few
    assert indistinguishable(chosen, [], LOOP) == []


def test_a_beam_that_drifts_is_no_effect() -> None:
    assert effect_candidate(BeamDrift()).is_control
    assert effect_candidate(ShapeDrift()).is_control
    assert not effect_candidate(AntennaGains()).is_control
    assert not weights_candidate().is_control
