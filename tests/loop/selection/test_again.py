"""Where something was taken back at the end, the search goes on once without it."""

from __future__ import annotations

from copy import copy

import numpy as np
import pytest

from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.instrument.antenna_positions import AntennaPositions
from hydrabeam_mpi.fit.clock import Clock
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.state import Active, Values
from hydrabeam_mpi.loop.selection.again import given_up, search
from hydrabeam_mpi.loop.selection.rounds import History
from hydrabeam_mpi.loop.selection.trials import check
from tests.loop.made import effect_candidate, round_of
from tests.loop.mock import context_of, mock_job

GAIN = {"kind": "antenna_gains", "parameters": {"antenna 2 ln amplitude": 0.06, "antenna 2 phase": -0.05}}
POSITIONS, GAINS = AntennaPositions(), AntennaGains()
GIVEN_UP = [("antenna_positions", "constant")]


@pytest.fixture(scope="module")
def context(tmp_path_factory: pytest.TempPathFactory) -> FitContext:
    return context_of(mock_job(GAIN), tmp_path_factory.mktemp("again"))


def with_positions(context: FitContext) -> History:
    """A history that has taken a gain for positions of all antennas."""
    n = len(POSITIONS.parameters(context.setup))
    start = Active.start(POSITIONS, context.setup, np.full(n, 0.1**2), np.zeros((1, n)))
    first, last = (check(context, refit(context, Values(active))) for active in ((), (start,)))
    return History(first, last, [round_of(effect_candidate(POSITIONS), first, last)])


def test_what_was_taken_back_is_not_offered_again(context: FitContext) -> None:
    history, kept = with_positions(context), []
    search(context, history, [POSITIONS], [], Clock(), lambda now: kept.append(copy(now)))
    assert given_up(history) == GIVEN_UP
    assert history.rounds[0].revoked
    assert history.ranking == ()
    # Whoever goes on from what was kept is in the second search.
    (last,) = kept
    assert given_up(last) == GIVEN_UP
    assert last.last is history.last
    assert last.last.fitted.values.active == ()
    search(context, last, [POSITIONS, GAINS], [], Clock(), lambda now: None)
    assert [one.kind for one in last.last.fitted.values.active] == ["antenna_gains"]
    assert {one.kind for one in last.ranking} == {"antenna_gains"}
    assert last.last.remains.consistent


def test_nothing_is_searched_again_where_all_stays(context: FitContext) -> None:
    first = check(context, refit(context, Values()))
    history, clock = History(first, first), Clock()
    said: list[int] = []
    search(context, history, [GAINS], [], clock, lambda now: said.append(len(now.rounds)))
    assert given_up(history) == []
    assert [one.candidate.kind for one in history.rounds] == ["antenna_gains"]
    assert said == [0, 0, 1]
