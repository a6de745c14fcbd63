"""What was taken back for what it is called, not for want of evidence, stays in the model where it predicts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydrabeam_mpi.effects.registry import make_effect
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.state import Active, Values
from hydrabeam_mpi.loop.attribution.control_models import BeamDrift
from hydrabeam_mpi.loop.selection.for_prediction import keep_for_prediction
from hydrabeam_mpi.loop.selection.history import History
from hydrabeam_mpi.loop.selection.predictions import check
from tests.loop.made import effect_candidate, round_of
from tests.loop.mock import context_of, mock_job

DRIFTING = make_effect("antenna_gains", {"law": "smooth", "orders": (1,)})


@pytest.fixture(scope="module")
def drifts(tmp_path_factory: pytest.TempPathFactory) -> FitContext:
    """Data of a beam that changes in time, fitted and held-out ones alike."""
    context = context_of(mock_job(), tmp_path_factory.mktemp("drifts"))
    effect, fitted = BeamDrift(), refit(context, Values())
    x = 0.05 * effect.parameters(context.setup).scale
    for share in (context.train, context.test):
        rows, added = share.calibrated(fitted.estimate)
        for span, block, _ in share.row_blocks(0, fitted.estimate, added[0], rows):
            share.rows.data[0, span] += effect.added(block, x)
    return context


def history_of(context: FitContext, may_predict: bool) -> History:
    """Gains that drift were found, and taken back at the end."""
    n = len(DRIFTING.parameters(context.setup))
    active = Active.start(DRIFTING, context.setup, np.full(n, 0.05**2), np.zeros((1, n)))
    without = check(context, refit(context, Values()))
    with_it = refit(context, Values((active,)), without.fitted)
    found = round_of(effect_candidate(DRIFTING), without, check(context, with_it))
    gone = with_it.values.active[0], with_it.fit.std[0]
    taken_back = replace(found, place=None, given_up=True, after=without, taken_back=gone, may_predict=may_predict)
    return History(without, without, [taken_back])


def test_it_is_in_the_model_and_not_claimed(drifts: FitContext) -> None:
    history = history_of(drifts, may_predict=True)
    claimed = history.last
    keep_for_prediction(drifts, history)
    assert history.claimed is claimed
    assert [one.kind for one in history.last.fitted.values.active] == ["antenna_gains"]
    (found,) = history.rounds
    assert found.revoked
    assert found.predicts
    assert history.last.score.log_density > claimed.score.log_density
    assert history.last.numbers.of_all["rms"] <= claimed.numbers.of_all["rms"]


def test_what_the_data_do_not_want_stays_out(drifts: FitContext) -> None:
    history = history_of(drifts, may_predict=False)
    before = history.last
    keep_for_prediction(drifts, history)
    assert history.last is before
    assert history.claimed is None
