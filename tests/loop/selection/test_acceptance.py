"""What is tried in which order, what is better, and what the last one leaves."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hydrabeam_mpi.config.effects import Loop
from hydrabeam_mpi.effects.instrument.antenna_delays import AntennaDelays
from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.instrument.antenna_positions import AntennaPositions
from hydrabeam_mpi.effects.instrument.cross_coupling import CrossCoupling
from hydrabeam_mpi.effects.instrument.timestamp import Timestamp
from hydrabeam_mpi.effects.registry import make_effect
from hydrabeam_mpi.effects.sky.catalogue_flux import CatalogueFlux
from hydrabeam_mpi.effects.sky.missing_sources import MissingSources
from hydrabeam_mpi.effects.sky.moving_sources import MovingSources
from hydrabeam_mpi.fit.gauss_newton import Underway
from hydrabeam_mpi.inference.significance import sigma_of_log_p
from hydrabeam_mpi.loop.attribution.control_models import BeamDrift, ShapeDrift
from hydrabeam_mpi.loop.selection.acceptance import (
    Candidate,
    improvement,
    in_order,
    indistinguishable,
    is_better,
    may_be_better,
    may_still_come_to,
)
from hydrabeam_mpi.loop.selection.heldout_score import fall_significance
from tests.loop.made import (
    N_DATA,
    blocks,
    checked,
    effect_candidate,
    integrations_candidate,
    round_of,
    weights_candidate,
)

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
    ("bad integrations first where they have the most", {"bad": 100, "gains": 50}, 6, ["bad", "gains"]),
    ("bad integrations later where they have not", {"bad": 100, "gains": 101}, 6, ["gains", "bad"]),
    ("what stays first where it comes near what moves", {"moving": 50, "places": 45, "missing": 36}, 6,
     ["missing", "moving", "places"]),
    ("what stays later where it does not", {"moving": 50, "places": 45, "missing": 34}, 6,
     ["moving", "places", "missing"]),
    ("a constant before a jump that comes to more", {"jumps": 50, "places": 45, "gains": 40}, 6,
     ["gains", "jumps", "places"]),
    ("only so many effects, and noise besides", {"gains": 50, "noise": 45, "delays": 40}, 1, ["gains", "noise"]),
]  # fmt: skip
NAMED = {
    "gains": AntennaGains(),
    "jumps": make_effect("antenna_gains", {"law": "piecewise", "jumps": [2459866.7]}),
    "delays": AntennaDelays(),
    "places": AntennaPositions(),
    "missing": MissingSources([(10.0, -30.0)]),
    "moving": MovingSources([(10.0, -30.0)]),
}


@pytest.mark.parametrize(("wanted", "most", "order"), [case[1:] for case in ORDERS], ids=ids(ORDERS))
def test_the_order_of_trials(wanted: dict[str, float], most: int, order: list[str]) -> None:
    weights = {"noise": weights_candidate, "bad": integrations_candidate}
    made = {
        name: effect_candidate(NAMED[name], evidence) if name in NAMED else weights[name](evidence)
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


def test_evidence_of_bad_integrations_is_of_all_data_already() -> None:
    """So that what an effect predicts of the held-out data counts beside it."""
    best = round_of(effect_candidate(AntennaGains(), 100.0), checked(2.0), checked(2.0, -50.0))
    assert best.evidence_of_all == pytest.approx(150)
    for evidence, better in ((149.0, False), (151.0, True)):
        bad = integrations_candidate(evidence)
        assert may_be_better(bad, best, enough=False) == better
        assert is_better(bad, checked(1.0, -1e4), best) == better


@pytest.mark.parametrize("enough", [False, True])
def test_effects_are_fitted_beside_bad_integrations(enough: bool) -> None:
    """These leave nothing of what shows at few times."""
    best = round_of(integrations_candidate(100.0), checked(2.0), checked(1.0))
    for log_bayes_factor, may in ((10.0, True), (9.9, False)):
        assert may_be_better(effect_candidate(AntennaPositions(), log_bayes_factor), best, enough) == may


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
    ("one of these that costs more at one place", effect_candidate(MissingSources(), 71.0, 0.1, 9, 28.0), True, False),
    ("one of these with too little evidence", effect_candidate(MissingSources(), 70.0, effective=9.0), True, False),
    ("one that is scanned but linear", effect_candidate(CrossCoupling(), 90.0, effective=9.0), True, False),
]


@pytest.mark.parametrize(("candidate", "enough", "may"), [case[1:] for case in MAY_BE], ids=ids(MAY_BE))
def test_what_may_be_better_once_it_is_fitted(candidate: Candidate, enough: bool, may: bool) -> None:
    best = round_of(effect_candidate(NAMED["gains"], 100.0, effective=2.0), checked(2.0), checked(1.2))
    assert may_be_better(candidate, best, enough) == may


POSITIONS = effect_candidate(AntennaPositions(), 900.0)
UNDERWAY = [
    ("at its beginning ten times what is expected", POSITIONS, (0.0, 101.0, 1000.0, 1000.0), False, True),
    ("and no more than that", POSITIONS, (0.0, 99.0, 1000.0, 1000.0), False, False),
    ("once what is expected of the end falls, no more", POSITIONS, (100.0, 800.0, 1000.0, 990.0), False, False),
    ("where it rises by so much on a part of the way", POSITIONS, (100.0, 890.0, 980.0, 990.0), False, True),
    ("where it rises by as much on more of the way", POSITIONS, (800.0, 190.0, 980.0, 990.0), False, False),
    ("near the end where all of the rise was to come from little", POSITIONS, (996.8, 3.1, 992.0, 999.9), False, True),
    ("and where that is not enough", POSITIONS, (996.8, 3.1, 999.0, 999.9), False, False),
    ("not so of places, which have no size before", POSITIONS, (100.0, 800.0, 1000.0, 990.0), True, True),
    ("a linear one as far as the beam goes with it", effect_candidate(AntennaGains(), 900.0),
     (0.0, 699.0, 1000.0, 1000.0), False, False),
]  # fmt: skip


@pytest.mark.parametrize(("candidate", "at", "nonlinear", "may"), [case[1:] for case in UNDERWAY], ids=ids(UNDERWAY))
def test_what_a_fit_may_still_come_to(
    candidate: Candidate, at: tuple[float, float, float, float], nonlinear: bool, may: bool
) -> None:
    """More than 900 are wanted of what costs 100 an element, 300 in all, as ln(likelihood x prior) rises from 50."""
    finding = candidate.finding
    assert finding is not None
    costly = replace(finding, evidence=replace(finding.evidence, linear_gain=1200.0))
    risen, expected, first, now = at
    underway = Underway(50.0 + risen, expected, (50.0 + first, 50.0 + now))
    assert may_still_come_to(900.0, replace(candidate, finding=costly), underway, 50.0, nonlinear) == may


@pytest.mark.parametrize(("price", "may"), [(None, False), (99.0, False), (98.0, True)])
def test_what_a_fit_says_that_its_freedom_costs_counts(price: float | None, may: bool) -> None:
    """Several sources have been weighed, and one has come to nearly as much at a part of what they cost."""
    finding = POSITIONS.finding
    assert finding is not None
    costly = replace(finding, evidence=replace(finding.evidence, linear_gain=1200.0))
    underway = Underway(1049.0, 0.0, (1049.0, 1049.0), price)
    assert may_still_come_to(900.0, replace(POSITIONS, finding=costly), underway, 50.0, True) == may


def test_everything_linear_says_so() -> None:
    """The table above takes these for what they are."""
    assert AntennaGains().linear
    assert CrossCoupling().linear
    assert not AntennaPositions().linear
    assert not MissingSources().linear


def test_weights_are_better_by_how_much_nearer_chi2_is() -> None:
    assert improvement(checked(2.0), checked(1.0), weights_candidate()) == pytest.approx(np.sqrt(N_DATA))
    assert improvement(checked(0.5), checked(1.0), weights_candidate()) == pytest.approx(0.5 * np.sqrt(N_DATA))


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
    # Others have to explain what the rest of a set explains beside it, too.
    assert [one.name for one in indistinguishable(chosen, ranking, LOOP, of_rest=50.0)] == few[:1]
    assert indistinguishable(chosen, ranking, LOOP, of_rest=300.0) == []
    # The evidence of bad integrations is of held-out data as well.
    bad = [integrations_candidate(120.0)]
    assert indistinguishable(chosen, bad, LOOP) == bad
    assert indistinguishable(chosen, bad, LOOP, of_heldout=24.0) == bad
    assert indistinguishable(chosen, bad, LOOP, of_heldout=26.0) == []


def test_evidence_of_the_rest_counts_where_the_ranking_was_made_without_it() -> None:
    first, second = effect_candidate(AntennaGains(), 100.0), effect_candidate(CatalogueFlux(), 60.0)
    for one, of_rest in ((first, 60.0), (second, 0.0)):
        found = round_of(one, checked(2.0), checked(1.2))
        assert found.evidence_of_rest == 0.0
        assert replace(found, together=(first, second)).evidence_of_rest == of_rest


def test_a_beam_that_drifts_is_no_effect() -> None:
    assert effect_candidate(BeamDrift()).is_control
    assert effect_candidate(ShapeDrift()).is_control
    assert not effect_candidate(AntennaGains()).is_control
    assert not weights_candidate().is_control
