"""What was chosen before others were known gives its place to what explains more beside them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.instrument.closure_errors import ClosureErrors
from hydrabeam_mpi.effects.instrument.cross_coupling import CrossCoupling
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.registry import make_effect
from hydrabeam_mpi.fit.clock import Clock
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.state import Active, Values
from hydrabeam_mpi.inference.mode_widths import PriorWidths
from hydrabeam_mpi.loop.attribution.reconsider import reconsider
from hydrabeam_mpi.loop.selection.acceptance import Candidate, Round
from hydrabeam_mpi.loop.selection.exchange import exchange, in_place_of
from hydrabeam_mpi.loop.selection.history import History
from hydrabeam_mpi.loop.selection.predictions import check
from hydrabeam_mpi.loop.selection.prior_widths import Adapted
from hydrabeam_mpi.loop.selection.rounds import Search, run_round
from tests.loop.made import effect_candidate, round_of
from tests.loop.mock import context_of, mock_job

GAIN = {"kind": "antenna_gains", "parameters": {"antenna 2 ln amplitude": 0.06, "antenna 2 phase": -0.05}}
COUPLED = {"kind": "cross_coupling", "settings": {"baselines": [[1, 4]]}, "parameters": {"baseline 1-4 real": 0.5}}
GAINS, COUPLING = AntennaGains(), CrossCoupling([[1, 4]])


@pytest.fixture(scope="module")
def context(tmp_path_factory: pytest.TempPathFactory) -> FitContext:
    return context_of(mock_job(GAIN, COUPLED), tmp_path_factory.mktemp("exchange"))


def factors(context: FitContext) -> ClosureErrors:
    """Of all baselines of the antenna whose gain is wrong: as good as the gain, with many more parameters."""
    return ClosureErrors([pair for pair in context.setup.observation.antpairs.tolist() if 2 in pair])


def rounds(context: FitContext, first: Effect, near: Effect | None, since: Effect | None) -> list[Round]:
    """Two rounds: an effect, which another may have come near, and the coupling."""
    active: list[Active] = []
    fits = [check(context, refit(context, Values()))]
    found: list[Round] = []
    for one in (first, since):
        if one is not None:
            n = len(one.parameters(context.setup))
            active.append(Active.start(one, context.setup, np.full(n, 0.1**2), np.zeros((1, n))))
            fits.append(check(context, refit(context, Values(tuple(active)))))
            others = [effect_candidate(near, 99.0)] if near is not None and one is first else []
            found.append(round_of(effect_candidate(one), fits[-2], fits[-1], *others))
    return found


def test_one_gain_in_the_place_of_the_factors_of_all_its_baselines(context: FitContext) -> None:
    so_far = rounds(context, factors(context), GAINS, COUPLING)
    last = so_far[-1].after
    found = exchange(context, last, so_far, [GAINS, COUPLING], [])
    assert found is not None
    added, places = found
    assert places == {0: None, 1: 0, 2: 1}
    assert [one.kind for one in added.after.fitted.values.active] == ["cross_coupling", "antenna_gains"]
    names = GAINS.parameters(context.setup).names
    used = added.after.fitted.values.active[1].used
    assert {names[i] for i in used} == {"antenna 2 ln amplitude", "antenna 2 phase"}
    assert added.before is last
    assert added.after.score.log_density > last.score.log_density - 5
    assert added.revised[0].startswith("closure errors: taken back")


def test_what_was_of_a_set_with_it_is_asked_unless_it_is_there(context: FitContext) -> None:
    """A set that leaves more than noise is not fitted: of it the effect may have been added alone."""
    so_far = rounds(context, factors(context), GAINS, COUPLING)
    of_set = tuple(effect_candidate(one) for one in (factors(context), GAINS))
    so_far = [replace(so_far[0], together=of_set), *so_far[1:]]
    found = exchange(context, so_far[-1].after, so_far, [GAINS, COUPLING], [])
    assert found is not None
    assert [one.kind for one in found[0].after.fitted.values.active] == ["cross_coupling", "antenna_gains"]
    present = rounds(context, factors(context), GAINS, GAINS)
    present = [replace(present[0], together=of_set), *present[1:]]
    tried: list[tuple[Candidate, str]] = []
    assert exchange(context, present[-1].after, present, [GAINS], tried) is None
    assert tried == []


def test_it_is_asked_where_no_more_effects_may_be_added(tmp_path: Path) -> None:
    full = context_of(mock_job(GAIN, COUPLED, loop={"max_rounds": 2}), tmp_path)
    so_far = rounds(full, factors(full), GAINS, COUPLING)
    history = History(so_far[0].before, so_far[-1].after, list(so_far))
    assert run_round(Search(full, history, [GAINS, COUPLING], [], Clock(), lambda _: None))
    assert {one.kind for one in history.last.fitted.values.active} == {"antenna_gains", "cross_coupling"}
    assert not run_round(Search(full, history, [GAINS, COUPLING], [], Clock(), lambda _: None))


def test_what_is_better_by_the_linear_model_comes_before_more_is_added(tmp_path: Path) -> None:
    further = {
        "kind": "cross_coupling",
        "settings": {"baselines": [[0, 3]]},
        "parameters": {"baseline 0-3 real": 0.002},
    }
    lacking = context_of(mock_job(GAIN, COUPLED, further), tmp_path)
    so_far = rounds(lacking, factors(lacking), GAINS, COUPLING)
    history = History(so_far[0].before, so_far[-1].after, list(so_far))
    search = Search(lacking, history, [GAINS, COUPLING, CrossCoupling([[0, 3]])], [], Clock(), lambda _: None)
    assert run_round(search)
    assert {one.kind for one in history.last.fitted.values.active} == {"antenna_gains", "cross_coupling"}
    assert len(history.last.fitted.values.active) == 2
    assert run_round(search)
    assert len(history.last.fitted.values.active) == 3


def test_nothing_is_fitted_that_has_less_by_the_linear_model(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A gain that also drifts a little: a constant one explains nearly as much."""
    settings = {"law": "smooth", "orders": [0, 1]}
    drift = {"antenna 2 ln amplitude, level": 0.06, "antenna 2 ln amplitude, drift from first to last time": 0.003}
    drifts = context_of(
        mock_job({"kind": "antenna_gains", "settings": settings, "parameters": drift}, COUPLED), tmp_path
    )
    so_far = rounds(drifts, make_effect("antenna_gains", settings), GAINS, COUPLING)
    last = so_far[-1].after
    own = reconsider(drifts, last.fitted, 0)
    assert in_place_of(drifts, last, 0, own, [GAINS])
    capsys.readouterr()
    assert exchange(drifts, last, so_far, [GAINS], [], only_more=True) is None
    assert "trying" not in capsys.readouterr().err


def test_a_law_in_the_place_of_another_of_the_same_effect(context: FitContext) -> None:
    drifting = make_effect("antenna_gains", {"law": "smooth", "orders": (1,)})
    so_far = rounds(context, drifting, GAINS, COUPLING)
    found = exchange(context, so_far[-1].after, so_far, [GAINS, COUPLING], [])
    assert found is not None
    active = found[0].after.fitted.values.active
    assert [(one.kind, one.effect.law) for one in active] == [
        ("cross_coupling", "constant"),
        ("antenna_gains", "constant"),
    ]


def test_a_law_of_a_constant_effect_is_looked_for_beside_it_not_in_its_place(context: FitContext) -> None:
    drifting = make_effect("antenna_gains", {"law": "smooth", "orders": (1,)})
    so_far, tried = rounds(context, GAINS, drifting, COUPLING), []  # type: tuple[list[Round], list[Any]]
    assert exchange(context, so_far[-1].after, so_far, [drifting, COUPLING], tried) is None
    assert not tried


def test_in_its_own_place_an_effect_has_the_evidence_that_it_has(context: FitContext) -> None:
    """The beam is as free to follow as where the effect is weighed as part of the model.

    Where fits have converged is known to a few percent of a standard deviation, of which these are 17,000.
    """
    last = rounds(context, COUPLING, None, CrossCoupling([[0, 2]]))[-1].after
    own = reconsider(context, last.fitted, 0)
    (found,) = in_place_of(context, last, 0, own, [COUPLING])
    assert own.log_bayes_factor > 50
    assert found.log_bayes_factor == pytest.approx(own.log_bayes_factor, rel=1e-4)
    assert in_place_of(context, last, 0, replace(own, log_bayes_factor=1.5 * own.log_bayes_factor), [COUPLING]) == []


def test_what_is_right_keeps_its_place(context: FitContext) -> None:
    so_far = rounds(context, GAINS, factors(context), COUPLING)
    tried: list = []
    assert exchange(context, so_far[-1].after, so_far, [factors(context)], tried) is None


def test_the_newest_is_asked_once_the_beams_prior_has_other_widths(tmp_path: Path) -> None:
    context = context_of(mock_job(GAIN), tmp_path)
    (found,) = rounds(context, factors(context), GAINS, None)
    values = replace(found.after.fitted.values, prior_widths=PriorWidths(0.2))
    wider = check(context, refit(context, values, found.after.fitted))
    adapted = Adapted(found.after, wider, 9.0, n_rounds=1, wider=True)
    # By the factors of single baselines more than noise is left of the others; it is asked as if nothing were.
    nothing_left = replace(wider, remains=replace(wider.remains, consistent=True))
    then = [replace(found, after=nothing_left)]
    assert exchange(context, nothing_left, then, [GAINS], []) is None
    assert exchange(context, wider, then, [GAINS], [], adapted=[adapted]) is None
    exchanged = exchange(context, nothing_left, then, [GAINS], [], adapted=[adapted])
    assert exchanged is not None
    assert [one.kind for one in exchanged[0].after.fitted.values.active] == ["antenna_gains"]
    before_it, functions_alone = replace(adapted, n_rounds=0), replace(adapted, before=wider)
    for other in (before_it, functions_alone):
        assert exchange(context, nothing_left, then, [GAINS], [], adapted=[other]) is None


@pytest.mark.parametrize("near", [None, GAINS])
def test_only_what_came_near_is_asked_and_only_once_something_was_found_since(
    near: Effect | None, context: FitContext
) -> None:
    so_far = rounds(context, factors(context), near, COUPLING if near is None else None)
    tried: list = []
    assert exchange(context, so_far[-1].after, so_far, [GAINS], tried) is None
    assert tried == []
