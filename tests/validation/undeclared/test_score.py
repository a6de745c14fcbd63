"""The scoring: right is right, wrong is wrong."""

import numpy as np
import pytest
from astropy.time import Time

from tests.validation.undeclared.match import AMONG_STARS, HERE, _from_stars, compare
from tests.validation.undeclared.score import score
from tests.validation.undeclared.setting import LOCATION


def answer(case="antenna_gains", parameters=(), where=None, **changes):
    nowhere = {"antennas": None, "antpairs": None, "times": None, "freqs": None}
    effects = [
        {
            "kind": kind,
            "strength": 0.1,
            "parameters": [dict(zip(("thing", "quantity", "unit", "value"), p, strict=True)) for p in parameters],
            "where": nowhere | (where or {}),
            "chi2_total": 4e4,
            "chi2_left": 1e4,
            "detectable": True,
        }
        for kind in ([] if case == "null" else case.split("+"))
    ]
    return {"case": case, "seed": 1, "times": [1.0, 2.0, 3.0, 4.0], "effects": effects} | changes


def a_round(effect, parameters=(), indistinguishable=()):
    told = [dict(zip(("name", "value", "std", "unit", "freq_hz"), (*p, "", None), strict=True)) for p in parameters]
    return {
        "effect": effect,
        "parameters": told,
        "indistinguishable_from": [{"effect": kind} for kind in indistinguishable],
    }


def loop(*rounds, verdict="explained", **changes):
    told = {"rounds": list(rounds), "verdict": verdict, "error_before": 5.0, "error_after": 1.01, "where": None}
    return told | {"conventions": {"found": None}} | changes


@pytest.mark.parametrize(
    ("rounds", "named"),
    [
        ([a_round("antenna_gains")], "right"),
        ([a_round("timestamp")], "wrong"),
        ([a_round("timestamp"), a_round("antenna_gains")], "wrong"),
        ([a_round("timestamp", indistinguishable=["antenna_gains"])], "indistinguishable"),
        ([], "none"),
    ],
)
def test_the_first_name_counts(rounds, named):
    assert score(answer(), loop(*rounds))["named"] == named


def test_what_changes_in_time_needs_its_law():
    truth = [("antenna 3", "phase, jump before time 2", "rad", 0.1)]
    given = answer("antenna_gains", truth)
    given["effects"][0]["law"] = "piecewise"
    jump = a_round("antenna_gains", [("antenna 3 phase, jump at JD 2.50000", 0.12, 0.01)]) | {"law": "piecewise"}
    told = score(given, loop(a_round("antenna_gains"), jump))
    assert told["law_named"]
    assert told["z"] == pytest.approx([2.0])
    assert not score(given, loop(a_round("antenna_gains")))["law_named"]
    assert score(answer(), loop(a_round("antenna_gains")))["law_named"] is None


def test_equivalent_names_are_told_apart_from_right_ones():
    assert score(answer("auto_coupling"), loop(a_round("cross_coupling")))["named"] == "equivalent"
    assert score(answer("timestamp"), loop(a_round("antenna_gains")))["named"] == "wrong"


def test_held_out_data_must_be_explained():
    assert score(answer(), loop(a_round("antenna_gains")))["heldout_holds"]
    assert not score(answer(), loop(a_round("antenna_gains"), error_after=1.11))["heldout_holds"]


def test_two_at_once_need_both():
    both = answer("antenna_gains+timestamp")
    assert score(both, loop(a_round("antenna_gains"), a_round("timestamp")))["both"]
    assert not score(both, loop(a_round("antenna_gains")))["both"]
    unsure = score(both, loop(a_round("antenna_gains"), a_round("horizon", indistinguishable=["timestamp"])))
    assert not unsure["both"]
    assert unsure["both_or_indistinguishable"]


def test_conventions_by_name():
    case = "convention: conjugated"
    conjugated, doubled = {"found": "conjugated"}, {"found": "factor 2"}
    assert score(answer(case), loop(verdict="convention", conventions=conjugated))["named"] == "right"
    assert score(answer(case), loop(verdict="explained", conventions=conjugated))["named"] == "wrong"
    assert score(answer(case), loop(verdict="convention", conventions=doubled))["named"] == "wrong"
    assert score(answer(case), loop())["named"] == "none"


def test_anything_found_in_nothing_is_a_false_alarm():
    assert not score(answer("null"), loop(verdict="consistent"))["false_alarm"]
    assert score(answer("null"), loop(verdict="unexplained"))["false_alarm"]
    assert score(answer("null"), loop(a_round("timestamp"), verdict="consistent"))["false_alarm"]


def axis(state, *entries, of=19):
    return {"state": state, "of": of, "count": len(entries), "entries": [dict(entry) for entry in entries]}


EVEN = axis("even")


def test_unknown_effects_must_be_where_they_are():
    turning = answer("turning_antenna", where={"antennas": [7]})
    right = {"antennas": axis("concentrated", {"what": 7, "share": 0.6}, {"what": 3, "share": 0.1}), "times": EVEN}
    wrong = {"antennas": axis("concentrated", {"what": 3, "share": 0.6}, {"what": 7, "share": 0.1}), "times": EVEN}
    told = score(turning, loop(verdict="unexplained", where=right))
    assert told["kept_unknown"]
    assert told["where_right"]
    assert not score(turning, loop(verdict="unexplained", where=wrong))["where_right"]
    assert not score(turning, loop(verdict="explained"))["kept_unknown"]


def test_what_all_have_alike_must_not_be_pinned_on_one_antenna():
    drift = answer("drifting_beam")
    everywhere = {"antennas": EVEN, "baselines": EVEN, "times": axis("uneven", {"what": {"jd": 4.0}, "share": 0.3})}
    pinned = everywhere | {"antennas": axis("concentrated", {"what": 7, "share": 0.9})}
    assert score(drift, loop(verdict="unexplained", where=everywhere))["where_right"]
    assert not score(drift, loop(verdict="unexplained", where=pinned))["where_right"]


def test_times_are_found_by_their_dates():
    moving = answer("moving_source", where={"times": [2, 3]})
    times = axis("concentrated", {"what": {"jd": 3.0}, "share": 0.5}, {"what": {"jd": 1.0}, "share": 0.2})
    assert score(moving, loop(verdict="unexplained", where={"times": times}))["where_right"]
    earlier = axis("concentrated", {"what": {"jd": 1.0}, "share": 0.5}, {"what": {"jd": 3.0}, "share": 0.2})
    assert not score(moving, loop(verdict="unexplained", where={"times": earlier}))["where_right"]


def z_of(case, parameters, found):
    given = answer(case, parameters)
    return compare(given["effects"][0], a_round(case, found), given).z


def test_deviations_are_in_sigma():
    truth = [("antenna 3", "phase", "rad", 0.1), ("antenna 4", "phase", "rad", 0.0)]
    assert z_of("antenna_gains", truth, [("antenna 3 phase", 0.13, 0.01)]) == pytest.approx([3.0])


def test_what_antennas_have_in_common_does_not_count():
    truth = [(f"antenna {n}", "delay", "ns", 0.1 * n) for n in range(5)]
    found = [(f"antenna {n} delay", 0.1 * n + 7.0, 0.01) for n in range(5)]
    np.testing.assert_allclose(z_of("antenna_delays", truth, found), 0, atol=1e-9)
    found[2] = ("antenna 2 delay", 7.3, 0.01)
    assert np.abs(z_of("antenna_delays", truth, found)).max() == pytest.approx(8.0)


def test_what_feeds_have_in_common_does_not_count():
    """The same c in all d_e and -c* in all d_n."""
    parts = {"e": {"real": 7.0, "imaginary": 3.0}, "n": {"real": -7.0, "imaginary": 3.0}}
    names = [
        (f"antenna {ant}", f"feed {feed} leakage, {part} part", common)
        for ant in range(5)
        for feed, commons in parts.items()
        for part, common in commons.items()
    ]
    truth = [(thing, quantity, "", 0.1) for thing, quantity, _ in names]
    found = [(f"{thing} {quantity}", 0.1 + common, 0.01) for thing, quantity, common in names]
    np.testing.assert_allclose(z_of("leakage", truth, found), 0, atol=1e-9)
    alike = [(f"{thing} {quantity}", 0.1 + abs(common), 0.01) for thing, quantity, common in names]
    assert np.abs(z_of("leakage", truth, alike)).max() == pytest.approx(700.0)


def test_gains_that_all_antennas_have_in_common_scale_couplings():
    """Only where there are gains."""
    truth = [(f"baseline 3-{n}", "real", "Jy", 1.0 + n) for n in range(5)]
    found = [(f"baseline 3-{n} real", 1.01 * (1.0 + n), 0.01) for n in range(5)]
    given = answer("cross_coupling+antenna_gains", truth)
    np.testing.assert_allclose(compare(given["effects"][0], a_round("cross_coupling", found), given).z, 0, atol=1e-9)
    assert np.abs(z_of("cross_coupling", truth, found)).max() == pytest.approx(5.0)


def test_a_baseline_may_be_named_the_other_way_round():
    truth = [("baseline 3-17", "real", "Jy", 1.0), ("baseline 3-17", "imaginary", "Jy", 2.0)]
    found = [("baseline 17-3 real", 1.1, 0.1), ("baseline 17-3 imaginary", -2.1, 0.1)]
    assert z_of("cross_coupling", truth, found) == pytest.approx([1.0, 1.0])


def test_sources_are_compared_where_they_are():
    truth = [
        ("source 0", "right ascension", "deg", 359.99),
        ("source 0", "declination", "deg", -30.0),
        ("source 0", "flux", "Jy", 2.0),
    ]
    name = "source at ra=0.010 dec=-30.000: "
    found = [(name + "flux", 2.2, 0.1), (name + "right ascension", 0.01, 0.3), (name + "declination", -30.0, 0.01)]
    told = dict(zip(("ra", "dec", "flux"), z_of("missing_sources", truth, found), strict=True))
    assert abs(told["ra"]) < 0.1
    assert abs(told["dec"]) < 0.1
    assert told["flux"] == pytest.approx(2.0)
    far = [*found[:2], (name + "declination", -38.0, 0.01)]
    assert z_of("missing_sources", truth, far) == pytest.approx([99.0])


def echo_at(number, delay, amplitude):
    name = f"antenna {number} reflection at {delay} ns: "
    return [(name + "amplitude", amplitude, 0.01), (name + "phase", 0.0, 0.1), (name + "delay", delay + 2.2, 1.0)]


def test_what_is_there_must_be_found():
    truth = [("antenna 3", "reflection real", "", 0.1)]
    assert z_of("cable_reflections", truth, echo_at(4, 90.0, 0.1))[0] > 10
    assert len(z_of("horizon", [], [("za 80-85 deg, az 0-30 deg: transmission less one", -1.0, 0.1)])) == 0


def test_of_several_echoes_the_strongest_counts():
    truth = [("antenna 3", "reflection real", "", 0.1), ("antenna 3", "reflection delay", "ns", 96.0)]
    strong, weak = echo_at(3, 93.8, 0.1), echo_at(3, 156.2, 0.001)
    for found in (strong + weak, weak + strong):
        np.testing.assert_allclose(z_of("cable_reflections", truth, found), 0, atol=1e-9)


def test_channels_are_averaged():
    given = answer("antenna_gains", [(f"antenna {n}", "phase", "rad", 0.0) for n in (3, 4)])
    told = a_round("antenna_gains", [("antenna 3 phase", 0.3, 0.1), ("antenna 3 phase", 0.1, 0.1)])
    assert compare(given["effects"][0], told, given).z == pytest.approx([0.2 / (0.1 / np.sqrt(2))])


def test_noise_scales_of_antennas_are_relative_to_that_of_all():
    truth = [("antenna 3", "noise scale", "", 1.44), ("antenna 4", "noise scale", "", 1.0)]
    found = [("noise scale", 1.2, 0.01), ("antenna 3 noise scale", 1.2, 0.01), ("antenna 4 noise scale", 1 / 1.2, 0.01)]
    np.testing.assert_allclose(z_of("noise_level", truth, found), 0, atol=1e-9)


@pytest.mark.parametrize("of_stars", [True, False])
def test_turns_about_axes_here_are_turns_about_those_among_the_stars(of_stars):
    """At a sidereal time of zero the first axis is towards the meridian, and the second towards East."""
    noon = Time(2459122.0, format="jd").sidereal_time("apparent", LOCATION.lon).hour
    middle = 2459122.0 + (24 - noon) / 24.0657098
    given = answer("orientation", times=[middle - 0.001, middle + 0.001])
    turn = _from_stars(given)
    latitude = LOCATION.lat.rad
    np.testing.assert_allclose(turn @ [0, 1, 0], [1, 0, 0], atol=1e-4)
    np.testing.assert_allclose(turn @ [0, 0, 1], [0, np.cos(latitude), np.sin(latitude)], atol=1e-12)
    among, here = np.array([3.0, -2.0, 5.0]), turn @ [3.0, -2.0, 5.0]
    truth, told = (among, here) if of_stars else (here, among)
    axes, told_axes = (AMONG_STARS, HERE) if of_stars else (HERE, AMONG_STARS)
    given["effects"][0]["parameters"] = [
        {"thing": "stars" if of_stars else "sky", "quantity": f"turned about {axis}", "unit": "arcmin", "value": value}
        for axis, value in zip(axes, truth, strict=True)
    ]
    things = ("sky turned, but not on the beam,", "stars turned")
    names = [f"{things[not of_stars]} about {axis}" for axis in told_axes]
    found = a_round("orientation", [(name, value, 0.1) for name, value in zip(names, told, strict=True)])
    compared = compare(given["effects"][0], found, given)
    assert len(compared.z) == 3
    np.testing.assert_allclose(compared.z, 0, atol=1e-9)
