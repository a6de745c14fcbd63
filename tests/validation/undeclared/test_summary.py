"""What all draws come to: every fraction goes down where something goes wrong."""

import numpy as np
import pytest

from tests.validation.undeclared.cases import CONVENTIONS, EFFECTS, FAULTS, IN_TIME, NULLS, STRONG, UNKNOWN
from tests.validation.undeclared.study import A_PASS, schedule
from tests.validation.undeclared.summary import KEYS, confusion, summarise, table


def draw(case, sort, **told):
    common = {"case": case, "seed": 1, "class": sort, "detectable": True, "verdict": "explained", "heldout_holds": True}
    return common | {"first": "none", "not_so": [], "revoked": [], "revoked_so": [], "at_noise": None} | told


DRAWS = [
    draw("timestamp", "single", named="right", first="timestamp", z=[0.5, 4.0], parameters_hold=False),
    draw("timestamp", "single", named="wrong", first="horizon", z=[], parameters_hold=None),
    draw("timestamp", "single", named="none", detectable=False, z=[], parameters_hold=None),
    draw("antenna_gains+timestamp", "pair", both=True, both_or_indistinguishable=True, named="right"),
    draw("turning_antenna", "unknown", kept_unknown=True, where_right=False),
    draw("null", "null", false_alarm=False),
    draw("null", "null", false_alarm=True, first="diffuse"),
    {"case": "horizon", "seed": 2, "class": "single", "failed": "reason"},
    {"case": "antenna_gains+timestamp", "seed": 3, "class": "pair", "failed": "reason"},
]


def test_fractions():
    told = summarise(DRAWS)
    assert told["named_right"] == pytest.approx(1 / 3, abs=1e-4)  # one right, one wrong, one that failed
    assert told["parameters_within_3_sigma"] == 0.0
    assert told["parameters_within_3_sigma_each"] == 0.5
    assert told["two_at_once"] == 0.5  # one that failed
    assert told["unknown_kept_unknown"] == 0.0
    assert told["false_alarms"] == 0.5
    assert told["draws"] == 9
    assert told["failed"] == 2
    assert set(KEYS) <= set(told)


def of(*draws):
    told = summarise(draws)
    return {key: told[key] for key in KEYS}


def named(how, case="timestamp", sort="single", **told):
    return draw(case, sort, named=how, parameters_hold=None, **told)


def test_equivalent_and_indistinguishable_names_are_right_but_not_alone():
    told = of(named("right"), named("equivalent"), named("indistinguishable"), named("wrong"))
    assert told["named_right"] == 0.75
    assert told["named_right_alone"] == 0.25


def test_faults_and_conventions_count_as_names_and_unseen_ones_do_not():
    draws = [named("right", "wrong_scale", "fault"), named("none", "convention: halved", "convention")]
    assert of(*draws, named("none", detectable=False))["named_right_alone"] == 0.5


def test_clean_draws_claim_nothing_wrong_whatever_their_class():
    unknown = draw("jitter", "unknown", kept_unknown=True, where_right=True, not_so=["antenna_gains"])
    failed = {"case": "horizon", "seed": 2, "class": "single", "failed": "reason"}
    assert of(named("right"), unknown)["clean"] == 0.5
    assert of(named("right"), unknown, failed)["clean"] == pytest.approx(1 / 3, abs=1e-4)
    assert of(named("none", detectable=False, not_so=["diffuse"]))["clean"] == 0.0


def test_three_at_once_are_counted_apart_from_two():
    both = draw("a+b", "pair", both=True, both_or_indistinguishable=True)
    triples = [draw("a+b+c", "triple", both=found, both_or_indistinguishable=True) for found in (True, False)]
    lost = {"case": "a+b+c", "seed": 3, "class": "triple", "failed": "reason"}
    assert of(both, *triples)["two_at_once"] == 1.0
    assert of(both, *triples)["three_at_once"] == 0.5
    assert of(both, *triples, lost)["three_at_once"] == pytest.approx(1 / 3, abs=1e-4)


def test_the_rms_counts_where_all_is_explained():
    draws = [named("right", at_noise=True), named("right", at_noise=False)]
    assert of(*draws, named("right", verdict="unexplained", at_noise=None))["rms_at_noise"] == 0.5
    assert of(named("right", verdict="consistent", at_noise=False))["rms_at_noise"] is None


def test_revoked_rounds_are_counted_and_were_rightly_so_if_they_were_wrong():
    told = summarise([named("right", revoked=["diffuse", "timestamp"], revoked_so=[False, True]), named("right")])
    assert told["revoked"] == 2
    assert told["revoked_rightly"] == 0.5
    assert summarise([named("right")])["revoked_rightly"] is None


def test_the_confusion_matrix_counts_detectable_draws():
    rows, columns, counts = confusion(DRAWS)
    assert counts[rows.index("timestamp"), columns.index("timestamp")] == 1
    assert counts[rows.index("timestamp"), columns.index("horizon")] == 1
    assert counts[rows.index("turning_antenna"), columns.index("unexplained")] == 1
    assert counts[rows.index("null"), columns.index("none")] == 1
    assert counts.sum() == 5


def test_the_table_names_what_went_wrong():
    lines = table(DRAWS).splitlines()
    assert any("timestamp" in line and "horizon (explained, seed 1)" in line for line in lines)
    assert any("FAILED (seed 2)" in line for line in lines)


def test_a_pass_has_every_effect_and_seeds_differ():
    n = 4 * (len(EFFECTS) + sum(A_PASS.values()))
    draws = schedule(n, 1000)
    assert len(draws) == n
    assert len({seed for _, seed in draws}) == n
    counts = np.unique([case for case, _ in draws], return_counts=True)
    counts = dict(zip(*counts, strict=True))
    assert counts["leakage"] == 4
    assert {name: counts[name] for name in NULLS} == {"null": 6, "null_of_band": 6}
    assert sum(name.count("+") == 2 for name in counts) == 6
    assert set(STRONG) | set(IN_TIME) | set(FAULTS) | set(CONVENTIONS) | set(UNKNOWN) <= set(counts)
