"""Where something was taken back at the end, the search goes on once without it."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.instrument.antenna_positions import AntennaPositions
from hydrabeam_mpi.effects.noise.noise_level import NoiseLevel
from hydrabeam_mpi.fit.clock import Clock
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.state import Active, Reweighted, Values
from hydrabeam_mpi.loop.attribution.score_noise import fit_reweightings
from hydrabeam_mpi.loop.selection.history import History
from hydrabeam_mpi.loop.selection.predictions import check
from hydrabeam_mpi.loop.selection.rounds import Search
from hydrabeam_mpi.loop.selection.search import given_up, run_search
from hydrabeam_mpi.loop.selection.taken_back import take_back_weights
from tests.loop.made import effect_candidate, round_of, weights_candidate
from tests.loop.mock import context_of, mock_job

GAIN = {"kind": "antenna_gains", "parameters": {"antenna 2 ln amplitude": 0.06, "antenna 2 phase": -0.05}}
POSITIONS, GAINS, NOISE = AntennaPositions(), AntennaGains(), NoiseLevel()
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
    run_search(Search(context, history, [POSITIONS], [], Clock(), lambda now: kept.append(copy(now))))
    assert given_up(history) == GIVEN_UP
    assert history.rounds[0].revoked
    assert history.ranking == ()
    # Whoever goes on from what was kept is in the second search.
    (last,) = kept
    assert given_up(last) == GIVEN_UP
    assert last.last.fitted.values.active == ()
    # Nothing explains the data, so that what cannot be claimed stays for prediction.
    assert history.rounds[0].predicts
    assert history.claimed is last.last
    assert [one.kind for one in history.last.fitted.values.active] == ["antenna_positions"]
    assert history.last.score.log_density > last.last.score.log_density
    run_search(Search(context, last, [POSITIONS, GAINS], [], Clock(), lambda now: None))
    assert [one.kind for one in last.last.fitted.values.active] == ["antenna_gains"]
    assert {one.kind for one in last.ranking} == {"antenna_gains"}
    assert last.last.remains.consistent
    # What stood for something is no more in the model: all of it is claimed.
    assert last.claimed is None


def test_nothing_is_searched_again_where_all_stays(context: FitContext) -> None:
    first = check(context, refit(context, Values()))
    history, clock = History(first, first), Clock()
    said: list[int] = []
    run_search(Search(context, history, [GAINS], [], clock, lambda now: said.append(len(now.rounds))))
    assert given_up(history) == []
    assert [one.candidate.kind for one in history.rounds] == ["antenna_gains"]
    assert said == [0, 0, 1]


def with_noise(context: FitContext) -> History:
    """A history that has taken what is wrong for noise first, and then for gains."""
    first = check(context, refit(context, Values()))
    (found,) = fit_reweightings(context, first.fitted, [NOISE])
    noise = Reweighted(NOISE, found.fit.x, found.fit.std)
    n = len(GAINS.parameters(context.setup))
    start = Active.start(GAINS, context.setup, np.full(n, 0.1**2), np.zeros((1, n)))
    second, last = (check(context, refit(context, Values(active, (noise,)), first.fitted)) for active in ((), (start,)))
    rounds = [round_of(weights_candidate(), first, second), round_of(effect_candidate(GAINS), second, last)]
    return History(first, last, [rounds[0], replace(rounds[1], place=0)])


def test_noise_that_something_else_explains_is_taken_back(context: FitContext) -> None:
    history = with_noise(context)
    run_search(Search(context, history, [], [NOISE], Clock(), lambda now: None))
    assert given_up(history) == [("noise_level", None)]
    assert [one.revoked for one in history.rounds] == [True, False]
    assert history.last.fitted.values.reweighted == ()
    assert [one.kind for one in history.last.fitted.values.active] == ["antenna_gains"]
    assert history.last.remains.consistent
    of_gains, of_noise = history.rounds[-1].revised
    assert "noise" in of_noise
    # Beside the noise as it is stated more can be told: all gains were fitted, and one antenna has another.
    assert of_gains == "antenna gains: 2 of 14 parameters stay"


def test_noise_that_is_there_stays(tmp_path: Path) -> None:
    """So does what the job itself has."""
    wrong = context_of(mock_job(GAIN), tmp_path)
    for share in (wrong.train, wrong.test):
        share.rows.inv_noise_var[:] *= 4
    last = with_noise(wrong).rounds[-1]
    assert take_back_weights(wrong, last, 0) == (last, frozenset())
    assert take_back_weights(wrong, last, 1) == (last, frozenset())
