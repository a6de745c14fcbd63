"""What ``loop.json`` says of a course that is made by hand."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.instrument.antenna_delays import AntennaDelays
from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.instrument.timestamp import Timestamp
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.error_scale import ErrorScale, error_scale
from hydrabeam_mpi.fit.state import Active, Fit, Fitted, Values, independent_prior
from hydrabeam_mpi.loop.attribution.control_models import BeamDrift
from hydrabeam_mpi.loop.output.amendment import amended_job
from hydrabeam_mpi.loop.output.parameters import parameters_of
from hydrabeam_mpi.loop.output.record import make_record
from hydrabeam_mpi.loop.output.round_record import known_effects
from hydrabeam_mpi.loop.selection.acceptance import Candidate
from hydrabeam_mpi.loop.selection.history import History
from hydrabeam_mpi.setup.findings import Finding
from tests.loop.made import checked, effect_candidate, integrations_candidate, numbers, round_of, weights_candidate
from tests.loop.mock import FREQ, context_of, mock_job

FREQS = (FREQ, FREQ + 8e6)


@pytest.fixture(scope="module")
def context(comm: MPI.Comm, tmp_path_factory: pytest.TempPathFactory) -> FitContext:
    """Two channels of a small array, on all ranks."""
    return context_of(mock_job(freqs=FREQS), comm.bcast(tmp_path_factory.mktemp("record")), comm)


def fitted(context: FitContext, effect: Effect, used: list[int], x: Any, std: Any) -> Fitted:
    """An effect of which some parameters are in use, with a prior of variance 0.02."""
    n = len(effect.parameters(context.setup))
    prior_var, values, errors = np.zeros(n), np.zeros((2, n)), np.zeros((2, n))
    prior_var[used], values[:, used], errors[:, used] = 0.02, x, std
    return Fitted(
        Values(
            (
                Active(
                    effect, *independent_prior(prior_var, effect.shared), values, np.full(n, np.inf), np.zeros((0, n))
                ),
            )
        ),
        Fit(std=(errors,)),
    )


def gains(context: FitContext, std: Any = ((0.01, 0.02), (0.03, 0.04))) -> Fitted:
    return fitted(context, AntennaGains(), [4, 5], [[0.06, -0.05], [0.07, -0.04]], std)


def train_chi2(context: FitContext, mean: float) -> FloatArray:
    """Of the rank group's channels, so that the mean over both channels is as given."""
    return np.array([mean - 0.5 + number for number in context.channels])


def history(context: FitContext, consistent: bool = True, control: bool = False, n_rounds: int = 1) -> History:
    """Gains and then a larger noise, beside which delays, a timestamp and a beam that drifts are weighed."""
    begins = consistent and n_rounds == 0
    first = checked(4.0, consistent=begins, train_chi2=train_chi2(context, 3.5), expected=2.0 if begins else 1.0)
    found = gains(context)
    ends, chi2 = consistent and n_rounds == 1, train_chi2(context, 1.25)
    second = checked(1.5, consistent=ends, train_chi2=chi2, fitted=found, expected=1.5**0.5 if ends else 1.0)
    third = checked(1.0, consistent=consistent, train_chi2=train_chi2(context, 1.0), fitted=found)
    drift = effect_candidate(BeamDrift(), 120.0)
    others = [drift, effect_candidate(AntennaDelays(), 96.0), effect_candidate(Timestamp(), 30.0)]
    rounds = [
        round_of(effect_candidate(AntennaGains(), 100.0), first, second, *others),
        round_of(weights_candidate(60.0, n_freqs=2), second, third, drift),
    ][:n_rounds]
    if rounds:
        rounds[0] = replace(
            rounds[0], together=(effect_candidate(AntennaGains(), 90.0), effect_candidate(Timestamp(), 0.5))
        )
    made = History(
        first, rounds[-1].after if rounds else first, rounds, ranking=(drift, weights_candidate(2.0, "of times"))
    )
    made.tried = [(drift, "wide"), (effect_candidate(Timestamp(), 30.0), "held-out chi^2 does not fall: 4 to 5")]
    made.control = round_of(drift, made.last, checked(1.2), *others) if control else None
    return made


AS_STATED = ErrorScale(np.ones(2), 1.0)
NONE_FOUND = {"found": None, "tested": [], "remedy": None}


def record_of(
    context: FitContext, made: History, leakage: dict[str, Any] | None = None, **conventions: Any
) -> dict[str, Any]:
    record = make_record(context, made, [("diffuse", "too long")], {**NONE_FOUND, **conventions}, leakage)
    assert json.loads(json.dumps(record, allow_nan=False)) == record
    return record


VERDICTS = [
    pytest.param(0, True, False, "consistent", id="noise from the start is consistent"),
    pytest.param(1, True, False, "explained", id="noise after a round is explained"),
    pytest.param(2, True, False, "explained", id="noise after two rounds is explained"),
    pytest.param(0, False, False, "unexplained", id="more than noise without a round is unexplained"),
    pytest.param(2, False, False, "unexplained", id="more than noise after rounds is unexplained"),
    pytest.param(1, True, True, "unexplained", id="what no effect explains as well is unexplained"),
]


@pytest.mark.mpi
@pytest.mark.parametrize(("n_rounds", "consistent", "control", "verdict"), VERDICTS)
def test_the_verdict(n_rounds: int, consistent: bool, control: bool, verdict: str, context: FitContext) -> None:
    record = record_of(context, history(context, consistent, control, n_rounds))
    assert record["verdict"] == verdict
    assert record["error_before"] == pytest.approx(4.0)
    assert record["error_after"] == pytest.approx([4.0, 1.5, 1.0][n_rounds])
    assert record["predictive_chi2_before"] == record["error_before"]
    assert record["predictive_chi2_after"] == record["error_after"]
    assert record["why"] is None or verdict == "unexplained"
    assert len(record["rounds"]) == n_rounds
    assert len(record["said"]) == n_rounds + 1
    assert record["warnings"] == []
    assert [record["where"] is not None, record["structures"] is not None] == [verdict == "unexplained"] * 2
    assert (record["foreign"] is not None) == control
    if control:
        assert record["foreign"]["effect"] == "beam_drift"
        assert record["foreign"]["heldout_after"] == pytest.approx(1.2)
        assert "A beam that changes in time would explain more" in record["said"][-1]


@pytest.mark.mpi
def test_what_is_calibrated_as_it_is_wide_alone_is_unexplained_with_nothing_found_too(context: FitContext) -> None:
    wide = checked(1.0, consistent=True, rms=3.0, train_chi2=train_chi2(context, 1.0))
    record = record_of(context, History(wide, wide, [], ranking=()))
    assert record["verdict"] == "unexplained"
    assert "only as they are wide" in record["why"]
    assert "explained by no effect" in record["sentence"]


def test_calibrated_but_wide_is_unexplained_with_the_reason(context: FitContext) -> None:
    """And the same as wide as the data leave the beam is explained."""
    for expected, at_noise, verdict in ((1.0, False, "unexplained"), (3.0, True, "explained")):
        made = history(context)
        made.last = replace(made.last, numbers=numbers(3.0, expected), at_noise=at_noise)
        record = record_of(context, made)
        assert record["verdict"] == verdict
    made.last = replace(made.last, numbers=numbers(3.0), at_noise=False)
    record = record_of(context, made)
    assert record["why"].startswith(
        "predictions are calibrated, but only as they are wide: the held-out residual has 3 Jy"
    )
    assert "Predictions are calibrated, but only as they are wide" in record["said"][-1]


IN_JY = {
    "rms_zero": 10.0, "rms_model": 5.0, "rms_model_scaled": 4.0, "rms_noise": 1.0, "rms_expected": 1.0,
    "explained_model": 0.75, "explained_model_scaled": 0.84,
}  # fmt: skip


def test_rounds_and_record_tell_held_out_data_in_jy(context: FitContext) -> None:
    """Of all channels and of each; a round by itself, the record from the first fit to the last."""
    record = record_of(context, history(context, n_rounds=2))
    for told, before, after in zip([record, *record["rounds"]], (4.0, 4.0, 1.5), (1.0, 1.5, 1.0), strict=True):
        assert [one["freq_hz"] for one in told["heldout_channels"]] == list(FREQS)
        for one in (told, *told["heldout_channels"]):
            assert {key: one[key] for key in IN_JY} == pytest.approx(IN_JY)
            fell = {
                "rms": (before**0.5, after**0.5),
                "explained": (1 - before / 100, 1 - after / 100),
                "noise_only_chi2": (before, after),
                "predictive_chi2": (before, after),
            }
            for key, pair in fell.items():
                assert (one[f"{key}_before"], one[f"{key}_after"]) == pytest.approx(pair)
            assert one["log_density_before"] < one["log_density_after"]
    assert "rms 2 -> 1.22 Jy (noise 1 Jy)" in record["said"][0]


@pytest.mark.mpi
def test_a_round_is_told_in_full(context: FitContext) -> None:
    one, two = record_of(context, history(context, n_rounds=2))["rounds"]
    expected = {
        "effect": "antenna_gains",
        "title": "antenna gains",
        "log_bayes_factor": 100.0,
        "absorbed_by_beam": 0.1,
        "runner_up": "antenna_delays",
        "runner_up_log_bayes_factor": 96.0,
        "runner_up_law": "constant",
        "indistinguishable_from": [{"effect": "antenna_delays", "law": "constant"}],
        "beam_change_max": 1e-3,
        "heldout_sigma": 12.0,
        "n_parameters": 4,  # of the last fit, two in each channel, by their errors beside the prior's
        "effective_parameters": pytest.approx(4 - 0.003 / 0.02),
        "chi2_drop": 200.0,
        "rank": 3,
        "prior_scale": pytest.approx(0.02**0.5),
    }
    assert {key: one[key] for key in expected} == expected
    fell = {key: [one[key], two[key]] for key in ("chi2_before", "chi2_after", "heldout_before", "heldout_after")}
    assert fell["chi2_before"] == pytest.approx([3.5, 1.25])
    assert fell["chi2_after"] == pytest.approx([1.25, 1.0])
    assert fell["heldout_before"] == pytest.approx([4.0, 1.5])
    assert fell["heldout_after"] == pytest.approx([1.5, 1.0])
    assert one["residual"] == {"overall": {"chi2": 4.0}}
    assert [line["effect"] for line in one["ranking"]] == ["antenna_gains", "antenna_delays", "timestamp"]
    gains, clock = one["together"]
    assert gains == {"effect": "antenna_gains", "law": "constant", "log_bayes_factor": 90.0}
    assert clock["effect"] == "timestamp"
    assert two["together"] == []
    assert [two[key] for key in ("runner_up", "indistinguishable_from", "prior_scale")] == [None, [], None]
    assert [two[key] for key in ("effect", "n_parameters", "rank", "chi2_drop")] == ["noise_level", 1, 1, 210.0]


def test_what_is_no_effect_is_neither_ranked_nor_tried(context: FitContext) -> None:
    record = record_of(context, history(context))
    (line,) = record["last_ranking"]
    assert [line["effect"], line["reason"]] == ["noise_level", "of times"]
    reason = "held-out chi^2 does not fall: 4 to 5"
    assert record["tried"] == [{"effect": "timestamp", "law": "constant", "log_bayes_factor": 30.0, "reason": reason}]
    assert record["skipped"] == [{"effect": "diffuse", "reason": "too long"}]
    some: list[Candidate] = [effect_candidate(BeamDrift()), effect_candidate(AntennaGains()), weights_candidate()]
    assert known_effects(some) == some[1:]


LEAKAGE = {
    "found": ({"effect": "leakage", "title": "leakage", "parameters": [], "sentence": "Leakage."}, "rounds", 7),
    "refused": ({"effect": "leakage", "log_bayes_factor": 1.0, "reason": "it is little"}, "tried", 6),
    "not looked for": ({"effect": "leakage", "reason": "the files have ee"}, "skipped", 6),
}


@pytest.mark.parametrize(("leakage", "place", "n_undecidable"), LEAKAGE.values(), ids=LEAKAGE)
def test_leakage_comes_first_where_it_belongs(
    leakage: dict[str, Any], place: str, n_undecidable: int, context: FitContext
) -> None:
    """What all antennas have of it in common is undecidable where there is some."""
    record, without = record_of(context, history(context), leakage), record_of(context, history(context))
    assert record[place] == [leakage, *without[place]]
    assert len(record["undecidable"]) == n_undecidable
    unchanged = {"rounds", "tried", "skipped"} - {place}
    assert {key: record[key] for key in unchanged} == {key: without[key] for key in unchanged}


@pytest.mark.parametrize("found", ["conjugated", "factor 1/2"])
def test_a_broken_convention_takes_the_place_of_all_rounds(found: str, context: FitContext) -> None:
    """A factor of the data has no convention of its own by which the model was tried: it is seen by its scale."""
    tested = [
        {"name": "as stated", "chi2": 90.0, "amplitude": 0.512, "explained": 0.999},
        {"name": "conjugated", "chi2": 1.1, "amplitude": 1.0, "explained": 1.0},
    ]
    remedy = "conjugate the data"
    record = record_of(
        context, history(context, consistent=False, n_rounds=0), None, found=found, tested=tested, remedy=remedy
    )
    assert record["verdict"] == "convention"
    assert record["where"] is record["structures"] is None
    (warning,) = record["warnings"]
    assert f"({found}): conjugate the data. Nothing was fitted to it" in warning
    (one,) = record["rounds"]
    assert one["effect"] == f"convention: {found}"
    assert one["chi2_before"] == 90.0
    assert one["chi2_after"] == (1.1 if found == "conjugated" else 90.0)
    assert one["heldout_before"] == one["heldout_after"] == pytest.approx(4.0)
    assert f"another convention: {found}. Nothing was fitted to it: conjugate the data" in record["said"][0]
    why = (
        "90 as stated and 1.1 so" if found == "conjugated" else "0.512 times as large the model beam explains 99.9000%"
    )
    assert why in record["said"][0]


def test_numbers_that_json_does_not_know_are_null(context: FitContext) -> None:
    made = history(context, consistent=False)
    remains = replace(made.last.remains, statistics={"inf": np.float64(np.inf), "n": np.int64(3), 5: (np.nan, 1.0)})
    made.last = replace(made.last, remains=remains)
    made.rounds[-1] = replace(made.rounds[-1], after=made.last, sigma=np.inf)
    record = record_of(context, made)
    assert record["residual"] == {"inf": None, "n": 3, "5": [None, 1.0]}
    assert record["rounds"][-1]["heldout_sigma"] is None


TOLD = [
    pytest.param(((0.01, 0.02), (0.03, 0.04)), 4, 0, id="what the data tell"),
    pytest.param(((0.0999, 0.02), (0.03, 0.04)), 4, 0, id="less than half of the prior's variance is told"),
    pytest.param(((0.1001, 0.02), (0.03, 0.04)), 3, 1, id="more than half comes apart"),
    pytest.param(((0.14, 0.02), (0.14, 0.04)), 2, 2, id="what no channel tells comes apart"),
    pytest.param(((0.14, 0.14), (0.14, 0.14)), 4, 0, id="where nothing is told all are given"),
]


@pytest.mark.parametrize(("std", "n_told", "n_not_told"), TOLD)
def test_parameters_that_the_data_do_not_tell_come_apart(
    std: Any, n_told: int, n_not_told: int, context: FitContext
) -> None:
    last = gains(context, std)
    one = round_of(effect_candidate(AntennaGains()), checked(2.0), checked(1.0, fitted=last))
    told, not_told = parameters_of(context.setup, one, last, AS_STATED)
    assert (len(told), len(not_told)) == (n_told, n_not_told)
    number = context.setup.observation.antenna_numbers[2]
    entries = {(entry["name"], entry["freq_hz"]): entry for entry in (*told, *not_told)}
    phase = entries[f"antenna {number} phase", FREQS[1]]
    assert phase == {
        "name": f"antenna {number} phase",
        "unit": "rad",
        "value": -0.04,
        "std": std[1][1],
        "sigma": 0.04 / std[1][1],
        "freq_hz": FREQS[1],
    }


@pytest.mark.parametrize("interrupted", [False, True])
def test_what_has_not_been_asked_yet_is_not_taken_for_confirmed(interrupted: bool, context: FitContext) -> None:
    """Effects are asked at the end alone; a change of the weights is not asked."""
    made = history(context, n_rounds=2)
    record = make_record(context, made, [], NONE_FOUND, None, interrupted)
    assert [one["asked"] for one in record["rounds"]] == [not interrupted, True]
    assert record["not_yet_asked"] == ["antenna_gains"] * interrupted
    assert ("Not yet asked of antenna gains: whether it is physical" in record["sentence"]) == interrupted
    assert ("Added, but not yet asked: whether it is" in record["rounds"][0]["sentence"]) == interrupted


def test_what_was_taken_back_is_not_what_the_model_lacked(context: FitContext) -> None:
    made = history(context)
    made.rounds[0] = replace(made.rounds[0], place=None)
    made.last = made.rounds[0].after
    record = record_of(context, made)
    assert record["rounds"][0]["revoked"]
    assert "Added at first, but taken back since." in record["rounds"][0]["sentence"]
    assert record["verdict"] == "consistent"
    assert "antenna gains" not in record["sentence"]


def test_cautions_and_what_stands_out_are_warnings(context: FitContext) -> None:
    odd = Finding("an antenna that stands out", "antenna 3", "it has 9 times what others have", "leave it out")
    made = history(context)
    made.last = replace(made.last, remains=replace(made.last.remains, odd=(odd,)))
    careful = replace(context, problem=replace(context.problem, cautions=("Antenna 5 is dead.",)))
    record = make_record(careful, made, [], NONE_FOUND, None)
    assert record["warnings"] == ["Antenna 5 is dead.", odd.line]
    assert make_record(careful, made, [], NONE_FOUND, None, interrupted=True)["warnings"] == ["Antenna 5 is dead."]


def test_errors_are_wider_where_more_than_noise_is_left(context: FitContext) -> None:
    """By channel, in parameters, in the sentence and in the amended job; values stay."""
    made = history(context, consistent=False)
    own = made.last.fitted.diagnostics
    chi2 = np.array([(20.0, 1.0)[number] for number in context.channels])
    made.last = replace(made.last, fitted=replace(made.last.fitted, diagnostics=replace(own, train_chi2=chi2)))
    (one,) = record_of(context, made)["rounds"]
    assert one["errors_widened_by"] == pytest.approx([20**0.5, 1.0], rel=1e-3)
    found = [entry["std"] for entry in (*one["parameters"], *one["parameters_not_told"])]
    expected = [0.01 * 20**0.5, 0.02 * 20**0.5, 0.03, 0.04]
    assert sorted(found) == pytest.approx(sorted(expected), rel=1e-3)
    assert "Errors are up to 4.47 times those by the noise alone" in one["sentence"]
    job = amended_job(context.problem.job, made.last.fitted, context.setup, error_scale(context, made.last.fitted))
    assert [*job.effects[0].std[0], *job.effects[0].std[1]] == pytest.approx(expected, rel=1e-3)
    assert job.effects[0].values == amended_job(context.problem.job, made.last.fitted, context.setup).effects[0].values


def test_parameters_are_those_of_the_last_joint_fit(context: FitContext) -> None:
    """Of the round's own effect, whichever others came after; those that channels share come once."""
    before = fitted(context, AntennaDelays(), [0], 9.0, 0.01)
    delays, later = fitted(context, AntennaDelays(), [0], 3.0, 0.02), gains(context)
    both = delays.values.extended(later.values.active[0])
    last = Fitted(both, Fit(std=(*delays.fit.std, *later.fit.std)))
    one = round_of(effect_candidate(AntennaDelays()), checked(2.0), checked(1.0, fitted=before))
    (told,), not_told = parameters_of(context.setup, one, last, AS_STATED)
    assert not not_told
    assert [told[key] for key in ("unit", "value", "std", "freq_hz")] == ["ns", 3.0, 0.02, None]


def test_bad_integrations_are_told_of_the_channels_in_which_they_are_bad(context: FitContext) -> None:
    one = integrations_candidate()
    assert one.weights is not None
    x = np.array([[1.0, 1.0, 3.0], [1.0, 20.0, 1.0]])
    fit = replace(one.weights.fit, x=x, std=0.1 * (x > 1))
    found = round_of(replace(one, weights=replace(one.weights, fit=fit)), checked(4.0), checked(1.0))
    told, not_told = parameters_of(context.setup, found, gains(context), AS_STATED)
    assert [(entry["name"], entry["value"], entry["freq_hz"]) for entry in told] == [
        ("c", 3.0, FREQS[0]), ("b", 20.0, FREQS[1])
    ]  # fmt: skip
    assert not not_told


def test_scales_of_the_noise_are_always_told(context: FitContext) -> None:
    (_, two) = history(context, n_rounds=2).rounds
    told, not_told = parameters_of(context.setup, two, gains(context), AS_STATED)
    assert [(one["name"], one["value"], one["freq_hz"]) for one in told] == [
        ("noise scale", 1.5, freq) for freq in FREQS
    ]
    assert not not_told
