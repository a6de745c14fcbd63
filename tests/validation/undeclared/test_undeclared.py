"""Two dozen draws with effects that the loop is not told of.

Their seeds were chosen among those that the loop deals with, to see that it goes on doing so: how often it does is told
by `tools/undeclared_study` alone, whose draws are not chosen.
"""

import numpy as np
import pytest

from tests.validation.undeclared.study import KEYS, confusion, run_draw, schedule, summarise, table

KNOWN = [
    ("antenna_gains", 1000),
    ("antenna_delays", 1001),
    ("missing_sources", 7),
    ("catalogue_flux", 8),
    ("antenna_positions", 10),
    ("timestamp", 11),
    ("antenna_pointing", 12),
    ("noise_level", 18),
    ("cable_reflections", 368),  # gains of each channel would leave as little
    ("antenna_pointing", 511),  # two degrees: products of beams, not their means
    ("outliers", 511),  # so strong that all rows stand out of the first fit
    ("noise_level", 7083),  # of one antenna
    ("catalogue_flux", 5573),  # the beam could absorb 96% of it
    ("timestamp", 5510),  # 25 s, in which sources rise and set
    ("leakage", 5548),  # of one antenna
]


@pytest.mark.parametrize(("case", "seed"), KNOWN)
def test_an_undeclared_effect_is_named_and_measured(case, seed):
    told = run_draw(case, seed)
    assert told.get("failed") is None
    assert told["detectable"]
    assert told["named"] == "right"
    assert told["verdict"] == "explained"
    assert told["heldout_holds"]
    assert told["parameters_hold"] is not False


def test_two_at_once_are_both_named():
    told = run_draw("antenna_gains+missing_sources", 1022)
    assert told.get("failed") is None
    assert told["detectable"]
    assert told["both"]


def test_a_wrong_convention_is_named_as_such():
    told = run_draw("convention: conjugated", 6)
    assert told.get("failed") is None
    assert told["named"] == "right"


@pytest.mark.parametrize(
    ("case", "seed"),
    [
        ("gain_jump", 7),
        ("gain_jump", 361),  # a third of a per cent
        ("decorrelation", 393),
        ("moving_source", 330),  # chi^2 of 233 among 6840 data
        ("drifting_noise", 6002),  # which makes anything with many parameters predict better by being less sure
        ("correlated_noise", 6000),  # of one baseline, whose large rows are no outliers
    ],
)
def test_what_no_effect_explains_stays_unexplained_where_it_is(case, seed):
    told = run_draw(case, seed)
    assert told.get("failed") is None
    assert told["detectable"]
    assert told["kept_unknown"]
    assert told["where_right"]


def test_nothing_is_found_where_nothing_is():
    told = run_draw("null", 20)
    assert told.get("failed") is None
    assert not told["false_alarm"]


def draw(case, sort, **told):
    common = {"case": case, "seed": 1, "class": sort, "detectable": True, "verdict": "explained", "heldout_holds": True}
    return common | {"first": "none"} | told


DRAWS = [
    draw("timestamp", "single", named="right", first="timestamp", z=[0.5, 4.0], parameters_hold=False),
    draw("timestamp", "single", named="wrong", first="horizon", z=[], parameters_hold=None),
    draw("timestamp", "single", named="none", detectable=False, z=[], parameters_hold=None),
    draw("antenna_gains+timestamp", "pair", both=True, both_or_indistinguishable=True, named="right"),
    draw("gain_jump", "unknown", kept_unknown=True, where_right=False),
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


def test_the_confusion_matrix_counts_detectable_draws():
    rows, columns, counts = confusion(DRAWS)
    assert counts[rows.index("timestamp"), columns.index("timestamp")] == 1
    assert counts[rows.index("timestamp"), columns.index("horizon")] == 1
    assert counts[rows.index("gain_jump"), columns.index("unexplained")] == 1
    assert counts[rows.index("null"), columns.index("none")] == 1
    assert counts.sum() == 5


def test_the_table_names_what_went_wrong():
    lines = table(DRAWS).splitlines()
    assert any("timestamp" in line and "horizon (explained, seed 1)" in line for line in lines)
    assert any("FAILED (seed 2)" in line for line in lines)


def test_a_pass_has_every_effect_and_seeds_differ():
    draws = schedule(132, 1000)
    assert len(draws) == 132
    assert len({seed for _, seed in draws}) == 132
    counts = np.unique([case for case, _ in draws], return_counts=True)
    assert dict(zip(*counts, strict=True))["leakage"] == 4
