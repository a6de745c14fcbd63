"""What a fitted effect is refused for, and in which words."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hydrabeam_mpi.config.effects import Loop
from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.instrument.basis_truncation import BasisTruncation
from hydrabeam_mpi.effects.sky.catalogue_flux import CatalogueFlux
from hydrabeam_mpi.fit.error_scale import Left
from hydrabeam_mpi.fit.state import Active, Ended, Fit, Fitted, Values, independent_prior
from hydrabeam_mpi.loop.attribution.constancy import Constancy
from hydrabeam_mpi.loop.attribution.control_models import BeamDrift
from hydrabeam_mpi.loop.selection.acceptance import Candidate
from hydrabeam_mpi.loop.selection.refusal import refusal_beside, refusal_by_parts, refusal_of, rise_of_rms, rivals_of
from hydrabeam_mpi.loop.selection.trials import least_evidence
from tests.loop.made import N_DATA, checked, effect_candidate, numbers, weights_candidate

LOOP = Loop()


def ids(cases: list[tuple[Any, ...]]) -> list[str]:
    return [case[0] for case in cases]


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
    ended = Ended.CONVERGED if given["converged"] else Ended.STUCK
    diagnostics = replace(after.fitted.diagnostics, ended=ended)
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


def test_one_division_of_the_data_that_tells_is_enough() -> None:
    """Where another cannot tell; not where it tells that there is no common part, nor where the first hardly tells."""
    cannot = Constancy("baselines", -13.9, -12.3, 3.1, expected_by_noise=66.2)
    assert refusal_by_parts([Constancy("times", 63.0, 68.0, 0.3, 150.0), cannot], LOOP) is None
    assert "between times" in str(refusal_by_parts([Constancy("times", 2.0, 68.0, 9.0, 150.0), cannot], LOOP))
    assert "cannot be told" in str(refusal_by_parts([Constancy("times", 1.0, 1.2, 0.0, 1.4), cannot], LOOP))


def test_how_parts_differ_is_told_in_numbers() -> None:
    assert refusal_by_parts([Constancy("times", -1.534, 54.26, 2.63, 54.26)], LOOP) == (
        "it is not the same in all parts of the data: its parameters differ between times by 2.6 times what they have "
        "in common (ln BF that they have a common part -1.53, where 54.3 is expected of what is the same in all)"
    )
    assert refusal_by_parts([Constancy("times", 8.0, 54.0, 2.6, 54.0)], Loop(min_log_bayes_factor=8.5)) is not None


def test_the_threshold_is_the_jobs() -> None:
    """For the evidence of the fitted data and for the density of those held out."""
    assert "log Bayes factor" in str(judged(fit(lbf=8.0), Loop(min_log_bayes_factor=8.5)))
    faint = fit(after={"chi2": 1.9, "log_spread": WIDER - 8.0})
    assert judged(faint) is None
    assert NO_BETTER in str(judged(faint, Loop(min_log_bayes_factor=8.5)))


def test_evidence_is_asked_for_in_units_of_what_is_left() -> None:
    """Nats count by the stated noise: beside three times its variance an effect needs three times as many."""
    found = effect_candidate(AntennaGains(), log_bayes_factor=14.0)
    left = Left(chi2=3014.0, free=1000.0)
    # The linear model expects half of its chi2_drop, 28, of the chi^2 of complex data.
    assert least_evidence(LOOP, left, found, is_in=False) == pytest.approx(15.0)
    assert least_evidence(LOOP, left, found, is_in=True) == pytest.approx(5.0 * 3.014)
    # Less than the noise would leave asks for no less, and a larger variance is what it is all about.
    assert least_evidence(LOOP, Left(900.0, 1000.0), found, is_in=True) == 5.0
    assert least_evidence(LOOP, left, weights_candidate(), is_in=False) == 5.0
    before, after = checked(2.0), checked(1.2)
    assert refusal_of(before, after, found, LOOP, least=14.0) is None
    words = "its log Bayes factor is 14 once it is fitted, where 15 is asked beside what is left, 3 times the noise"
    assert refusal_of(before, after, found, LOOP, least=15.0) == words


def test_what_predicts_worse_than_nothing_is_refused_however_few_blocks_that_comes_from() -> None:
    """Of the data's 10 Jy rms; where one time has all of the rise there is no scatter to tell it from chance."""
    before = checked(5.0, rms=6.0)
    times, groups = before.numbers.times.copy(), before.numbers.groups.copy()
    rise = (12.0**2 - 6.0**2) * times[1].sum()
    times[0, 3] += rise
    groups[0, 2] += rise
    after = checked(1.2, rms=12.0)
    after = replace(after, numbers=replace(after.numbers, times=times, groups=groups))
    assert after.numbers.rise_sigma(before.numbers) < 1.1
    assert rise_of_rms(before, after) == "the held-out residual has 12 Jy rms, where predicting nothing leaves 10"
    # What was worse still gets better.
    assert rise_of_rms(checked(5.0, rms=13.0), after) is None
