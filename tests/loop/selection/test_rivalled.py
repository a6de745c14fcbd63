"""What was found has to hold at the end beside a beam that changes in time, whatever it stood beside before."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.registry import make_effect
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.state import Active, Values
from hydrabeam_mpi.fit.step import solved_at
from hydrabeam_mpi.loop.attribution.control_models import BeamDrift, ShapeDrift
from hydrabeam_mpi.loop.attribution.score_effects import attribute
from hydrabeam_mpi.loop.selection.acceptance import Candidate, Round
from hydrabeam_mpi.loop.selection.predictions import check
from hydrabeam_mpi.loop.selection.rivalled import take_back_rivalled
from hydrabeam_mpi.loop.selection.trials import least_beside
from tests.loop.made import effect_candidate, round_of
from tests.loop.mock import context_of, mock_job

FAULTS = [BeamDrift(), ShapeDrift()]
DRIFTING = make_effect("antenna_gains", {"law": "smooth", "orders": (1,)})


def add_drift(context: FitContext) -> None:
    """Let the beam change in time, as `BeamDrift` has it."""
    effect, fitted = BeamDrift(), refit(context, Values())
    x = 0.05 * effect.parameters(context.setup).scale
    rows, added = context.train.calibrated(fitted.estimate)
    for span, block, _ in context.train.row_blocks(0, fitted.estimate, added[0], rows):
        context.train.rows.data[0, span] += effect.added(block, x)


def round_with(context: FitContext, *effects: Effect) -> Round:
    """Return the last of rounds that have added effects."""
    active = []
    for one in effects:
        n = len(one.parameters(context.setup))
        active.append(Active.start(one, context.setup, np.full(n, 0.05**2), np.zeros((1, n))))
    before = refit(context, Values(tuple(active[:-1])))
    after = refit(context, Values(tuple(active)), before)
    return round_of(effect_candidate(effects[-1]), check(context, before), check(context, after))


@pytest.fixture(scope="module")
def drifts(tmp_path_factory: pytest.TempPathFactory) -> FitContext:
    context = context_of(mock_job(), tmp_path_factory.mktemp("drifts"))
    add_drift(context)
    return context


def test_gains_that_stand_for_a_beam_that_changes_are_taken_back(
    drifts: FitContext, capsys: pytest.CaptureFixture[str]
) -> None:
    last = round_with(drifts, DRIFTING)
    without, places, asked = take_back_rivalled(drifts, last, 0, FAULTS)
    assert places == {0: None}
    assert asked == {}
    assert without.after.fitted.values.active == ()
    assert without.revised[0].startswith(
        "antenna gains that drift: taken back, as a beam that changes in time explains"
    )
    assert without.revised[0] in capsys.readouterr().err
    # What the job itself has is not asked, nor is anything where no rivals are looked for.
    for n_given, faults in ((1, FAULTS), (0, [])):
        assert take_back_rivalled(drifts, last, n_given, faults) == (last, {0: 0}, {})


def test_a_gain_that_is_wrong_stays(tmp_path: Path) -> None:
    gain = {"kind": "antenna_gains", "parameters": {"antenna 2 ln amplitude": 0.06, "antenna 2 phase": -0.05}}
    context = context_of(mock_job(gain), tmp_path)
    last = round_with(context, AntennaGains())
    assert take_back_rivalled(context, last, 0, FAULTS) == (last, {0: 0}, {})


def test_each_of_several_control_models_is_a_rival(drifts: FitContext) -> None:
    fitted = round_with(drifts, DRIFTING).after.fitted
    without = solved_at(drifts, Values(), fitted, keep=True)
    both = list(map(Candidate.of, attribute(drifts, without, FAULTS)))
    alone = [least_beside(drifts, fitted, {0: [one]})[0].log_bayes_factor for one in both]
    assert alone[0] != pytest.approx(alone[1], abs=1)
    for order in (both, both[::-1]):
        assert least_beside(drifts, fitted, {0: order})[0].log_bayes_factor == min(alone)
