"""What an array on a lattice sees alike in two places is told to be in either, and where it is likelier."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hydrabeam_mpi.data.observation import C_M_PER_S
from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.instrument.ground_emitter import GroundEmitter
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.state import Active, Values
from hydrabeam_mpi.loop.rules import RULES
from hydrabeam_mpi.loop.selection import elsewhere
from hydrabeam_mpi.loop.selection.elsewhere import tell_elsewhere
from hydrabeam_mpi.loop.selection.history import History
from hydrabeam_mpi.loop.selection.predictions import check
from hydrabeam_mpi.loop.selection.refits import log_joint
from tests.loop.made import effect_candidate, round_of
from tests.loop.mock import FREQ, context_of, mock_job

NORTH = 14.6 * np.sqrt(0.75)
"""By which rows of antennas are apart, m."""
AZIMUTH = float(np.rad2deg(np.arcsin(10 * C_M_PER_S / FREQ / (2 * NORTH))))
"""Degrees from East through North: the same as far in the South is ten whole wavelengths away between rows."""
ALONE = 30.0


@pytest.fixture(scope="module")
def context(tmp_path_factory: pytest.TempPathFactory) -> FitContext:
    emitters = {
        "kind": "ground_emitter",
        "settings": {"azimuths": [AZIMUTH, ALONE]},
        "parameters": {f"emitter at azimuth {one:.2f} deg: power": 0.3 for one in (AZIMUTH, ALONE)},
    }
    return context_of(mock_job(emitters), tmp_path_factory.mktemp("elsewhere"))


def history_of(context: FitContext, effect: Effect) -> History:
    before = check(context, refit(context, Values()))
    size = len(effect.parameters(context.setup))
    active = Active.start(effect, context.setup, np.tile([1.0, 0.0], size // 2), np.zeros((1, size)))
    after = check(context, refit(context, Values((active,))))
    return History(before, after, [round_of(effect_candidate(effect), before, after)])


@pytest.mark.parametrize("begun_at", [AZIMUTH, -AZIMUTH % 360], ids=["where it is", "where it is seen alike"])
def test_either_place_is_told_and_the_likelier_one_is_the_model(context: FitContext, begun_at: float) -> None:
    history = history_of(context, GroundEmitter([begun_at, ALONE]))
    before = log_joint(context, history.last.fitted)
    tell_elsewhere(context, history)
    (one,) = history.rounds
    (active,) = history.last.fitted.values.active
    (other,) = one.elsewhere
    assert one.after is history.last
    assert -5 < other.log_likelihood_ratio <= 0
    assert log_joint(context, history.last.fitted) > before - 0.1
    told = active.effect.told(context.setup, active.x, history.last.fitted.fit.std[0])
    azimuth, std = told.values[0, 1], told.std[0, 1]
    power, there = other.parameters
    assert abs(there["value"] % 360 - (-azimuth % 360)) < 5 * std
    assert (power["unit"], there["unit"]) == ("Jy", "deg")
    assert power["value"] == pytest.approx(told.values[0, 0], rel=0.05)


@pytest.mark.parametrize(("most", "told"), [(1, 1), (0, 0)])
def test_most_places(context: FitContext, most: int, told: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(elsewhere, "RULES", replace(RULES, most_places=most))
    history = history_of(context, GroundEmitter([AZIMUTH, ALONE]))
    tell_elsewhere(context, history)
    assert len(history.rounds[0].elsewhere) == told


def test_what_is_taken_back_or_has_no_place_is_nowhere_else(context: FitContext, tmp_path: Path) -> None:
    history = history_of(context, GroundEmitter([AZIMUTH, ALONE]))
    history.rounds = [replace(history.rounds[0], given_up=True)]
    tell_elsewhere(context, history)
    assert history.rounds[0].elsewhere == ()
    gains = context_of(mock_job({"kind": "antenna_gains", "parameters": {"antenna 3 phase": 0.1}}), tmp_path)
    history = history_of(gains, AntennaGains())
    last = history.last
    tell_elsewhere(gains, history)
    assert history.rounds[0].elsewhere == ()
    assert history.last is last
