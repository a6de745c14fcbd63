"""Some draws with effects that the loop is not told of.

Their seeds were chosen among those that the loop deals with, to see that it goes on doing so: how often it does is told
by `tools/undeclared_study` alone, whose draws are not chosen.
"""

import pytest

from tests.validation.undeclared.study import run_draw

KNOWN = [
    ("antenna_gains", 1000),
    ("missing_sources", 7),
    ("flux_at_transit", 3),  # the beam could absorb 98% of it
    ("antenna_pointing", 511),  # two degrees: products of beams, not their means
    ("leakage", 5548),  # of one antenna
    ("clock_of_few", 5),  # the beam could absorb 98% of 5 s, with seven antennas
    ("outliers", 511),  # so strong that all rows stand out of the first fit
    ("cable_reflections", 368),  # gains of each channel would leave as little
    ("antenna_delays", 1001),
    ("saturation", 5000),
    ("decorrelation", 393),
    ("antenna_positions", 10),
    ("antenna_pointing", 12),
    ("noise_level", 18),
    ("noise_level", 7083),  # of one antenna
    ("catalogue_flux", 5573),  # the beam could absorb 96% of it
    ("timestamp", 5510),  # 25 s, in which sources rise and set
    ("gain_jump", 371),  # by 0.6%
    ("water_vapour", 3),  # phases of all antennas, anew at each time
    ("clock_jump", 4),
    ("fading_source", 50016),
    ("source_positions", 2),  # by 50 arcsec
    ("polarised_sources", 2),  # the beam could absorb 94% of it
]


@pytest.mark.study
@pytest.mark.parametrize(("case", "seed"), KNOWN)
def test_an_undeclared_effect_is_named_and_measured(case, seed):
    told = run_draw(case, seed)
    assert told.get("failed") is None
    assert told["detectable"]
    assert told["named"] == "right"
    assert told["law_named"] is not False
    assert told["verdict"] == "explained"
    assert told["heldout_holds"]
    assert told["parameters_hold"] is not False


@pytest.mark.study
def test_two_at_once_are_both_named():
    told = run_draw("antenna_gains+missing_sources", 1022)
    assert told.get("failed") is None
    assert told["detectable"]
    assert told["both"]


@pytest.mark.study
def test_a_wrong_convention_is_named_as_such():
    told = run_draw("convention: conjugated", 6)
    assert told.get("failed") is None
    assert told["named"] == "right"


@pytest.mark.parametrize(
    ("case", "seed"),
    [
        # Of one baseline, whose large rows are no outliers.
        pytest.param("correlated_noise", 6000, marks=pytest.mark.study),
        pytest.param("moving_source", 333, marks=pytest.mark.study),
        # Which makes anything with many parameters predict better by being less sure.
        pytest.param("drifting_noise", 6002, marks=pytest.mark.study),
    ],
)
def test_what_no_effect_explains_stays_unexplained_where_it_is(case, seed):
    told = run_draw(case, seed)
    assert told.get("failed") is None
    assert told["detectable"]
    assert told["kept_unknown"]
    assert told["where_right"]


def test_antennas_that_are_dead_are_named_and_nothing_else_is():
    told = run_draw("dead_antennas", 3)
    assert told.get("failed") is None
    assert told["named"] == "right"
    assert told["verdict"] == "consistent"
    assert told["not_so"] == []
    assert told["at_noise"]


def test_nothing_is_found_where_nothing_is():
    told = run_draw("null", 20)
    assert told.get("failed") is None
    assert not told["false_alarm"]
