"""What the loop says of parameters, rounds and verdicts."""

from __future__ import annotations

from typing import Any

import pytest

from hydrabeam_mpi.loop.output.sentences import say_parameter, say_round, say_verdict

PARAMETERS: dict[str, tuple[dict[str, Any], str]] = {
    "with a unit and a channel": (
        {"name": "antenna 2 phase", "value": -0.05123, "std": 0.00123, "unit": "rad", "freq_hz": 131e6},
        "antenna 2 phase -0.05123 +- 0.0012 rad at 131 MHz",
    ),
    "a pure number": (
        {"name": "antenna 2 ln amplitude", "value": 0.04, "std": 1.2e-5, "unit": "", "freq_hz": 157.507e6},
        "antenna 2 ln amplitude 0.04 +- 1.2e-05 at 157.507 MHz",
    ),
    "a place, of which there are many digits": (
        {"name": "source right ascension", "value": 80.7424312, "std": 0.00021, "unit": "deg", "freq_hz": None},
        "source right ascension 80.74243 +- 0.00021 deg",
    ),
    "an error of which nothing is known": (
        {"name": "antenna 2 delay", "value": 3.14159, "std": 0.0, "unit": "ns", "freq_hz": None},
        "antenna 2 delay 3.142 +- 0 ns",
    ),
    "of all channels": (
        {"name": "antenna 2 delay", "value": 3.0, "std": 0.5, "unit": "ns", "freq_hz": None},
        "antenna 2 delay 3 +- 0.5 ns",
    ),
}


@pytest.mark.parametrize(("parameter", "said"), PARAMETERS.values(), ids=PARAMETERS)
def test_parameters(parameter: dict[str, Any], said: str) -> None:
    assert say_parameter(parameter) == said


def parameter(name: str, value: float, std: float = 1.0) -> dict[str, Any]:
    sigma = abs(value) / std if std else None
    return {"name": name, "value": value, "std": std, "sigma": sigma, "unit": "", "freq_hz": None}


def told(**given: Any) -> dict[str, Any]:
    usual = {
        "title": "antenna gains",
        "parameters": [parameter("one", 2)],
        "parameters_not_told": [],
        "errors_widened_by": [1.0, 1.0],
        "asked": True,
        "revoked": False,
        "predicts": False,
        "left_out": None,
        "log_bayes_factor": 5110910.4,
        "absorbed_by_beam": 0.071,
        "heldout_before": 257.12,
        "heldout_after": 1.1678,
        "rms_before": 5.432,
        "rms_after": 0.3456,
        "rms_noise": 0.3201,
        "beam_change_max": 3.62e-3,
        "indistinguishable_from": [],
        "elsewhere": [],
    }
    return {**usual, **given}


FEW = [parameter("one", 2), parameter("two", -9), parameter("three", 5), parameter("four", 3), parameter("five", 4)]
TIMES = [
    *(parameter(f"antenna 2 phase at JD {jd}", value) for jd, value in ((1.5, 3), (2.5, -4), (3.5, 5))),
    *(parameter(f"antenna 2 phase, jump at JD {jd}", 3) for jd in (1.5, 2.5)),
    parameter("antenna 3 phase at JD 1.5", 2),
]
ROUNDS: dict[str, tuple[dict[str, Any], str]] = {
    "the whole of it": (
        {},
        "Antenna gains: one 2 +- 1 (log Bayes factor 5,110,910; the beam can absorb 7% of it). Added. "
        "Held-out reduced chi^2 257 -> 1.17; rms 5.43 -> 0.346 Jy (noise 0.32 Jy); the beam moves by up to 3.6e-03.",
    ),
    "the four most significant": (
        {"parameters": FEW},
        "gains: two -9 +- 1; three 5 +- 1; five 4 +- 1; four 3 +- 1; and 1 more (",
    ),
    "what has a value at each of several times": (
        {"parameters": TIMES, "parameters_not_told": FEW[:2]},
        "Antenna gains: antenna 2 phase 4.08 rms over 3 times; antenna 2 phase, jump at JD 1.5 3 +- 1; "
        "antenna 2 phase, jump at JD 2.5 3 +- 1; antenna 3 phase at JD 1.5 2 +- 1; "
        "and 2 that these data do not tell (",
    ),
    "and one of these that has most of it": (
        {"parameters": [parameter(f"antenna 2 phase at JD {jd}", v) for jd, v in ((1.5, 3), (2.5, -8), (3.5, 5))]},
        "Antenna gains: antenna 2 phase 5.72 rms over 3 times, most of it at JD 2.5 (-8 +- 1) (",
    ),
    "what has a value in each of several directions": (
        {"parameters": [parameter(f"flux towards ra={ra:.3f} dec=-30.000", ra - 11) for ra in (8.0, 15.0)]},
        "Antenna gains: flux 3.54 rms over 2 directions (",
    ),
    "those that are not told are counted": (
        {"parameters_not_told": FEW[:2]},
        "Antenna gains: one 2 +- 1; and 2 that these data do not tell (",
    ),
    "what is chosen, without an error, comes last": (
        {"parameters": [parameter("threshold", 25, 0.0), *FEW[:2]]},
        "two -9 +- 1; one 2 +- 1; threshold 25 +- 0 (",
    ),
    "how much wider than by the noise alone": (
        {"errors_widened_by": [1.0, 4.472]},
        "3.6e-03. Errors are up to 4.47 times those by the noise alone, as more than noise is left of the data.",
    ),
    "where the rows are that are left out": (
        {"left_out": {"sentence": "30 of 600 rows (5%) are left out."}},
        "3.6e-03. 30 of 600 rows (5%) are left out.",
    ),
    "what has not been asked yet": (
        {"asked": False},
        "7% of it). Added, but not yet asked: whether it is physical beside all others and the same in all parts of "
        "the data. Held-out reduced chi^2",
    ),
    "what is not claimed and stays": (
        {"revoked": True, "predicts": True},
        "7% of it). Added at first, and not claimed: it stays in the model for prediction. Held-out reduced chi^2",
    ),
    "what has been taken back": (
        {"revoked": True},
        "7% of it). Added at first, but taken back since. Held-out reduced",
    ),
    "as much in all channels": ({"errors_widened_by": [2.0, 2.0]}, " Errors are 2 times those by the noise alone,"),
    "where it may be as well": (
        {
            "elsewhere": [
                {
                    "log_likelihood_ratio": ratio,
                    "parameters": [
                        {"name": f"emitter at azimuth 9 deg: {what}", "unit": unit, "value": value, "freq_hz": freq}
                        for freq in (1.0e8, 1.1e8)
                        for what, unit, value in (("power", "Jy", 2.51234), ("azimuth", "deg", azimuth))
                    ],
                }
                for ratio, azimuth in ((-1.234, 278.0), (-4.0, 40.5))
            ]
        },
        "3.6e-03. These data do not tell it from another place: power 2.5123 Jy, azimuth 278 deg (ln likelihood -1.2); "
        "or power 2.5123 Jy, azimuth 40.5 deg (ln likelihood -4).",
    ),
    "what it is not told from": (
        {
            "indistinguishable_from": [
                {"effect": "antenna_delays", "law": "smooth"},
                {"effect": "timestamp", "law": None},
            ]
        },
        "3.6e-03. These data do not tell it from antenna delays, smooth or timestamp.",
    ),
}


@pytest.mark.parametrize(("given", "said"), ROUNDS.values(), ids=ROUNDS)
def test_rounds(given: dict[str, Any], said: str) -> None:
    sentence = say_round(told(**given))
    assert said in sentence
    assert sentence.endswith(".")


WHERE = {"sentence": "It is on antenna 5."}
DRIFT = {"title": "a beam that changes in time", "log_bayes_factor": 1234.5, "heldout_after": 1.23456}
GAINS, SOURCES = ({"effect": name.replace(" ", "_"), "title": name} for name in ("antenna gains", "missing sources"))
WEIGHED = [
    {"effect": "antenna_gains", "log_bayes_factor": 1234.5},
    {"effect": "timestamp", "log_bayes_factor": 7.0},
    {"effect": "outliers", "log_bayes_factor": -1.0},
]
EXCHANGED = {"what": "two antennas exchanged", "where": "antennas 2 and 15"}
INTEGRATION = {"what": "a bad integration", "where": "JD 1"}
CONVENTION = {"found": "conjugated", "remedy": "conjugate the data"}
LOST = {"sentence": "9 of 90 visibilities are left out: 100% of baseline 2-7."}
VERDICTS: dict[str, tuple[str, dict[str, Any], str]] = {
    "nothing is missing": (
        "consistent",
        {},
        "Nothing is missing: the data agree with the model within the noise (held-out reduced chi^2 1.012).",
    ),
    "nothing is missing in what is left of the data": (
        "consistent",
        {"health": [EXCHANGED, *5 * [INTEGRATION]]},
        "Nothing is missing: the data agree with the model within the noise (held-out reduced chi^2 1.012). "
        "Of the data themselves: two antennas exchanged (antennas 2 and 15), a bad integration (JD 1), "
        "a bad integration (JD 1), "
        "a bad integration (JD 1) and 2 more.",
    ),
    "nothing is left": (
        "explained",
        {"rounds": [GAINS, SOURCES, GAINS]},
        "The model lacked antenna gains and missing sources; with that added nothing significant is left "
        "(held-out reduced chi^2 11.4 -> 1.012).",
    ),
    "it was interrupted": (
        "interrupted",
        {"rounds": [GAINS, SOURCES, GAINS], "not_yet_asked": ["antenna_gains"], "last_ranking": WEIGHED},
        "Interrupted: what is left (held-out reduced chi^2 11.4 -> 1.012) was not looked at. Not yet asked of antenna "
        "gains: whether it is physical beside all others and the same in all parts of the data. None of it is "
        "confirmed. The same command goes on from here.",
    ),
    "it was interrupted before anything was weighed": (
        "interrupted",
        {},
        "Interrupted: what is left (held-out reduced chi^2 1.012) was not looked at. "
        "The same command goes on from here.",
    ),
    "it was interrupted in the first round": (
        "interrupted",
        {"last_ranking": WEIGHED},
        "Interrupted: what is left (held-out reduced chi^2 1.012) was not looked at. Weighed, but not yet fitted: "
        "antenna gains (log Bayes factor 1,234) and timestamp (log Bayes factor 7). "
        "The same command goes on from here.",
    ),
    "a convention is broken": (
        "convention",
        {"rounds": [{"title": "convention: conjugated"}], "conventions": CONVENTION},
        "The data follow another convention than the one stated (conjugated): conjugate the data. Nothing was fitted "
        "to it, and the inferred beam is not to be used.",
    ),
    "something is left": (
        "unexplained",
        {"why": "predictions are not calibrated"},
        "What is left (held-out reduced chi^2 1.012) is explained by no effect in the catalogue. Predictions are not "
        "calibrated. It is on antenna 5.",
    ),
    "the beam's prior got its last widths after all that is claimed": (
        "unexplained",
        {"why": "predictions are not calibrated", "error_claimed": 1.2},
        "What is left (held-out reduced chi^2 1.012) is explained by no effect in the catalogue. Before the beam's "
        "prior got its last widths, predictions are not calibrated. It is on antenna 5.",
    ),
    "something is left beside what was found": (
        "unexplained",
        {"rounds": [GAINS]},
        "The model lacked antenna gains, and something else that no effect in the catalogue explains (held-out reduced "
        "chi^2 11.4 -> 1.012). It is on antenna 5.",
    ),
    "nothing is left of what was found": (
        "unexplained",
        {"rounds": [GAINS | {"revoked": True}]},
        "What is left (held-out reduced chi^2 1.012) is explained by no effect in the catalogue. What was added at "
        "first was taken back: antenna gains. It is on antenna 5.",
    ),
    "what is not claimed predicts": (
        "unexplained",
        {"rounds": [GAINS | {"revoked": True, "predicts": True}], "error_claimed": 2.7051},
        "What is left (held-out reduced chi^2 1.012) is explained by no effect in the catalogue. Antenna gains: not "
        "claimed, but in the model, which predicts held-out data better so (reduced chi^2 2.705 without). It is on "
        "antenna 5.",
    ),
    "something that is no effect would explain it": (
        "unexplained",
        {"foreign": DRIFT, "why": "predictions are not calibrated"},
        "What is left (held-out reduced chi^2 1.012) is explained by no effect in the catalogue. A beam that changes "
        "in time would explain more than any of them (log Bayes factor 1,234, held-out reduced chi^2 1.235). "
        "It is on antenna 5.",
    ),
    "data left out that nobody knows": (
        "unexplained",
        {
            "rounds": [{"title": "bad baselines", "effect": "bad_baselines", "of_unknown": True, "left_out": LOST}],
            "why": "the data that carry something unknown are left out, and of all others nothing significant is left",
            "where": None,
        },
        "Some of the data carry something that no effect in the catalogue explains (held-out reduced chi^2 11.4 -> "
        "1.012). The data that carry something unknown are left out, and of all others nothing significant is left. "
        "9 of 90 visibilities are left out: 100% of baseline 2-7.",
    ),
    "the same beside an effect and something else": (
        "unexplained",
        {
            "rounds": [
                {"title": "antenna gains", "effect": "antenna_gains", "of_unknown": False},
                {"title": "bad baselines", "effect": "bad_baselines", "of_unknown": True, "left_out": LOST},
            ],
            "why": "predictions are not calibrated",
        },
        "The model lacked antenna gains, and some of the data carry something that no effect in the catalogue explains "
        "(held-out reduced chi^2 11.4 -> 1.012). Predictions are not calibrated. 9 of 90 visibilities are left out: "
        "100% of baseline 2-7. It is on antenna 5.",
    ),
}


@pytest.mark.parametrize(("verdict", "given", "said"), VERDICTS.values(), ids=VERDICTS)
def test_verdicts(verdict: str, given: dict[str, Any], said: str) -> None:
    nothing: dict[str, Any] = {"rounds": [], "foreign": None, "why": None, "health": [], "error_claimed": 1.01234}
    nothing |= {"not_yet_asked": [], "last_ranking": []}
    usual = {"error_before": 11.4, "error_after": 1.01234, "where": WHERE, **nothing}
    assert say_verdict({"verdict": verdict, **usual, **given}) == said
