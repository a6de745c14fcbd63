"""What is claimed and is not so: tables of made-up records and what they must score."""

import numpy as np
import pytest

from tests.validation.undeclared.claims import not_so
from tests.validation.undeclared.faults_told import faults_not_so, names_fault
from tests.validation.undeclared.score import at_noise, score
from tests.validation.undeclared.test_score import a_round, answer, echo_at, loop

GAIN = [("antenna 3", "phase", "rad", 0.1), *((f"antenna {n}", "phase", "rad", 0.0) for n in (4, 5, 6))]
COUPLING = [("baseline 3-17", "real", "Jy", 1.0), ("baseline 3-17", "imaginary", "Jy", 2.0)]
FLUX = [("source 7", "relative change of flux", "", 0.1)]
SOURCE = [
    ("source 0", "right ascension", "deg", 10.0),
    ("source 0", "declination", "deg", -30.0),
    ("source 0", "flux", "Jy", 2.0),
]
DELAY = [("antenna 3", "reflection real", "", 0.1)]
NOISE = [("antenna 3", "noise scale", "", 1.5), *((f"antenna {n}", "noise scale", "", 1.0) for n in (4, 5))]


def phases(*values):
    return [(f"antenna {n} phase", value, 0.01) for n, value in zip((3, 4, 5, 6), values, strict=True)]


def found_at(ra, dec, flux):
    name = f"source at ra={ra} dec={dec}"
    numbers = {"flux": (flux, 0.1), "right ascension": (float(ra), 0.01), "declination": (float(dec), 0.01)}
    return [(f"{name}: {quantity}", *pair) for quantity, pair in numbers.items()]


@pytest.mark.parametrize(
    ("case", "parameters", "found", "wrong"),
    [
        ("antenna_gains", GAIN, phases(0.1, 0.0, 0.01, -0.01), []),
        ("antenna_gains", GAIN, phases(0.4, 0.3, 0.31, 0.29), []),  # all have it in common: no data tell
        ("antenna_gains", GAIN, phases(0.1, 0.2, 0.0, 0.0), ["antenna_gains: antenna 4"]),
        ("cross_coupling", COUPLING, [("baseline 17-3 real", 1.0, 0.01)], []),
        (
            "cross_coupling",
            COUPLING,
            [("baseline 3-17 real", 1.0, 0.01), ("baseline 3-4 real", 0.04, 0.01)],
            [],  # 4 sigma are no claim
        ),
        (
            "cross_coupling",
            COUPLING,
            [("baseline 3-17 real", 1.0, 0.01), ("baseline 3-4 real", 0.06, 0.01)],
            ["cross_coupling: baseline 3-4"],
        ),
        ("catalogue_flux", FLUX, [("source 7: relative flux error", 0.1, 0.001)], []),
        ("catalogue_flux", FLUX, [("source 8: relative flux error", 0.1, 0.001)], ["catalogue_flux: source 8"]),
        ("missing_sources", SOURCE, found_at("10.300", "-30.200", 2.0), []),
        (
            "missing_sources",
            SOURCE,
            [*found_at("10.300", "-30.200", 2.0), *found_at("10.300", "-33.200", 2.0), *found_at("50.0", "-30.0", 0.4)],
            ["missing_sources: source at ra=10.300 dec=-33.200"],
        ),
        (
            "cable_reflections",
            DELAY,
            [*echo_at(3, 90.0, 0.1), *echo_at(4, 90.0, 0.1)],
            ["cable_reflections: antenna 4"],
        ),
        ("noise_level", NOISE, [(f"antenna {n} noise scale", v, 0.01) for n, v in ((3, 1.5), (4, 1.0), (5, 1.0))], []),
        (
            "noise_level",
            NOISE,
            [(f"antenna {n} noise scale", v, 0.01) for n, v in ((3, 1.5), (4, 1.2), (5, 1.0))],
            ["noise_level: antenna 4"],
        ),
    ],
)
def test_things_that_have_nothing(case, parameters, found, wrong):
    assert not_so(answer(case, parameters), loop(a_round(case, found))) == wrong


@pytest.mark.parametrize(
    ("case", "rounds", "wrong"),
    [
        ("timestamp", ["timestamp"], []),
        ("timestamp", ["timestamp", "diffuse"], ["diffuse"]),
        ("timestamp", ["basis_truncation"], ["basis_truncation"]),
        ("null", ["basis_truncation"], ["basis_truncation"]),
        ("auto_coupling", ["cross_coupling"], []),
        ("turning_antenna", ["timestamp"], ["timestamp"]),
        ("drifting_noise", ["noise_level"], []),
        ("jitter", ["noise_level"], ["noise_level"]),
        ("antenna_gains+timestamp", ["timestamp", "antenna_gains"], []),
        ("antenna_gains+timestamp+diffuse", ["horizon"], ["horizon"]),
        ("bad_integrations", ["outliers"], []),
    ],
)
def test_effects_that_are_not_there(case, rounds, wrong):
    assert not_so(answer(case), loop(*map(a_round, rounds))) == wrong


def test_a_round_that_may_as_well_be_the_right_one_claims_nothing_wrong():
    assert not_so(answer("timestamp"), loop(a_round("diffuse", indistinguishable=["timestamp"]))) == []
    assert not_so(answer("timestamp"), loop(a_round("diffuse", indistinguishable=["horizon"]))) == ["diffuse"]


def test_conventions_that_are_kept():
    halved = answer("convention: halved")
    assert not_so(halved, loop(conventions={"found": "factor 1/2"})) == []
    told = loop(a_round("convention: factor 1/2"), conventions={"found": "factor 1/2"})
    assert not_so(halved, told) == []
    assert not_so(halved, loop(conventions={"found": "conjugated"})) == ["convention: conjugated"]
    assert not_so(answer(), loop(conventions={"found": "conjugated"})) == ["convention: conjugated"]


def test_what_was_revoked_is_not_claimed():
    rounds = [a_round("diffuse") | {"revoked": True}, a_round("timestamp"), a_round("horizon")]
    told = score(answer("timestamp"), loop(*rounds))
    assert told["first"] == "timestamp"
    assert told["named"] == "right"
    assert told["revoked"] == ["diffuse"]
    assert told["revoked_so"] == [False]
    assert told["not_so"] == ["horizon"]
    given_up = score(answer("timestamp"), loop(a_round("timestamp") | {"revoked": True}))
    assert given_up["named"] == "none"
    assert given_up["revoked_so"] == [True]


def test_three_at_once_need_all():
    three = answer("antenna_gains+timestamp+diffuse")
    names = ["antenna_gains", "timestamp", "diffuse"]
    assert score(three, loop(*map(a_round, names)))["class"] == "triple"
    assert score(three, loop(*map(a_round, names)))["both"]
    for missed in names:
        assert not score(three, loop(*(a_round(name) for name in names if name != missed)))["both"]


@pytest.mark.parametrize(
    ("rms", "expected", "verdict", "told"),
    [
        (1.0, 1.0, "explained", True),
        (1.014, 1.0, "explained", True),  # of 10,000 complex data the error is a half per cent
        (1.016, 1.0, "explained", False),
        (0.984, 1.0, "explained", False),
        (1.3, 2.0, "explained", True),  # the prior leaves the beam more room than it takes
        (2.1, 2.0, "consistent", False),
        (0.984, 2.0, "explained", False),
        (1.016, 1.0, "unexplained", None),
        (1.0, 1.0, "convention", None),
        (1.0, None, "explained", None),
    ],
)
def test_the_rms_is_that_of_the_noise(rms, expected, verdict, told):
    said = loop(verdict=verdict, rms_after=rms, rms_expected=expected, rms_noise=1.0, heldout_n=10_000)
    assert at_noise(said) is told


def test_complex_noise_is_within_its_error():
    """The rms of n complex numbers has the standard deviation 1/(2 sqrt n)."""
    draws = np.random.default_rng(1).standard_normal((1000, 100, 2)) / np.sqrt(2)
    rms = np.sqrt((draws**2).sum(axis=2).mean(axis=1))
    within = [at_noise(loop(rms_after=value, rms_expected=1.0, rms_noise=1.0, heldout_n=100)) for value in rms.tolist()]
    assert np.mean(within) == pytest.approx(0.997, abs=0.005)
    assert rms.std() == pytest.approx(1 / 20, rel=0.1)


def health(*remedies):
    return loop(health=[{"what": "something", "where": "somewhere", "remedy": remedy} for remedy in remedies])


SCALE = [("array", "scale", "", 0.002)]


@pytest.mark.parametrize(
    ("case", "truth", "remedy", "right"),
    [
        ("wrong_scale", {"parameters": SCALE}, "calibrate, or flux_scale = 520.1 in [data]", True),
        ("wrong_scale", {"parameters": SCALE}, "flux_scale = 5.201e+02 in [data]", True),
        ("wrong_scale", {"parameters": SCALE}, "flux_scale = 700 in [data]", False),
        ("wrong_scale", {"parameters": SCALE}, "exclude_antennas = [7] in [data]", False),
        ("dead_antennas", {"where": {"antennas": [7, 3]}}, "exclude_antennas = [3, 7] in [data]", True),
        ("dead_antennas", {"where": {"antennas": [7, 3]}}, "exclude_antennas = [3] in [data]", False),
        ("dead_antennas", {"where": {"antennas": [3]}}, "exclude_antennas = [3, 7] in [data]", False),
        ("bad_integrations", {"where": {"times": [1]}}, "exclude_times = [[1.9, 2.1]] in [data]", True),
        ("bad_integrations", {"where": {"times": [1]}}, "exclude_times = [[1.9, 3.1]] in [data]", False),
        ("bad_integrations", {"where": {"times": [1, 2]}}, "exclude_times = [[1.9, 2.1]] in [data]", False),
    ],
)
def test_faults_must_be_told_in_full(case, truth, remedy, right):
    given = answer(case, **truth)
    assert names_fault(given["effects"][0], health(remedy), given) is right
    assert score(given, health(remedy))["named"] == ("right" if right else "none")
    assert not names_fault(given["effects"][0], loop(), given)


@pytest.mark.parametrize(("times", "right"), [([1], True), ([1, 2], False), ([2], False)])
def test_bad_integrations_that_a_round_leaves_out(times, right):
    given = answer("bad_integrations", where={"times": [1]})
    left_out = [(f"JD {given['times'][k]:.6f} noise scale", 30.0, 1.0) for k in times]
    found = loop(a_round("bad_integrations", left_out))
    assert names_fault(given["effects"][0], found, given) is right
    wrong = [f"bad integration: {k}" for k in times if k != 1]
    assert not_so(given, found) + faults_not_so(given, found) == wrong


def test_integrations_that_carry_what_nobody_knows_may_be_left_out():
    """As by a source that passes; those without it may not."""
    given = answer("moving_source", where={"times": [1]})
    for time, wrong in ((1, []), (2, ["bad integration: 2"])):
        found = loop(a_round("bad_integrations", [(f"JD {given['times'][time]:.6f} noise scale", 30.0, 1.0)]))
        assert not_so(given, found) + faults_not_so(given, found) == wrong


@pytest.mark.parametrize(
    ("case", "where", "remedy", "wrong"),
    [
        ("null", None, "exclude_antennas = [3] in [data]", ["bad antenna: 3"]),
        ("dead_antennas", {"antennas": [3]}, "exclude_antennas = [3] in [data]", []),
        (
            "antenna_gains",
            {"antennas": [3]},
            "exclude_antennas = [3] in [data]",
            ["bad antenna: 3"],
        ),
        ("cables_swapped", {"antennas": [3, 4]}, "exclude_antennas = [3, 4] in [data]", []),
        ("bad_integrations", {"times": [1]}, "exclude_times = [[1.9, 3.1]] in [data]", ["bad integration: 2"]),
        ("board_drops_packets", {"antpairs": [[9, 2]]}, "exclude_baselines = [[2, 9]] in [data]", []),
        ("jitter", None, "exclude_baselines = [[2, 9]] in [data]", ["bad baseline: 2-9"]),
        ("null", None, "flux_scale = 1.3 in [data]", ["wrong flux scale"]),
        ("convention: halved", None, "flux_scale = 2.0 in [data]", []),
        ("null", None, "declare another channel width", ["something"]),
        ("noise_level", None, "declare another channel width", []),
    ],
)
def test_faults_that_are_none(case, where, remedy, wrong):
    assert faults_not_so(answer(case, where=where), health(remedy)) == wrong


def test_a_fault_in_data_without_an_effect_is_a_false_alarm():
    nothing = loop(verdict="consistent", health=[])
    assert not score(answer("null"), nothing)["false_alarm"]
    alarm = health("exclude_antennas = [3] in [data]") | {"verdict": "consistent"}
    assert score(answer("null"), alarm)["false_alarm"]


def test_a_fault_beside_an_effect_needs_both():
    two = answer("dead_antennas+timestamp", where={"antennas": [3]})
    said = health("exclude_antennas = [3] in [data]")
    assert not score(two, said)["both"]
    assert score(two, said | {"rounds": [a_round("timestamp")]})["both"]
    assert not score(two, loop(a_round("timestamp")))["both"]


def test_what_carries_an_unknown_effect_may_be_left_out():
    swapped = answer("cables_swapped", where={"antennas": [3, 4]})
    right, wrong = (health(f"exclude_antennas = {two} in [data]") for two in ([3, 4], [3, 5]))
    for told, good in ((right, True), (wrong, False)):
        judged = score(swapped, told | {"verdict": "consistent"})
        assert (judged["kept_unknown"], judged["where_right"]) == (good, good)


def test_a_place_that_is_not_told_from_the_true_one_claims_nothing_wrong():
    """An array on a lattice sees both alike."""
    given, wrong = answer("moving_sources", SOURCE), a_round("moving_sources", found_at("10.0", "-20.0", 3.0))
    assert not_so(given, loop(wrong)) == ["moving_sources: source at ra=10.0 dec=-20.0"]
    true = a_round("moving_sources", found_at("10.0", "-30.0", 2.0))["parameters"]
    for parameters, left in ((true, []), (wrong["parameters"], ["moving_sources: source at ra=10.0 dec=-20.0"])):
        told = {**wrong, "elsewhere": [{"log_likelihood_ratio": -1.0, "parameters": parameters}]}
        assert not_so(given, loop(told)) == left
        assert score(given, loop(told))["parameters_hold"] == (not left)
