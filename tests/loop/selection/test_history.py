"""Which control model is told of when all is done."""

from __future__ import annotations

from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.loop.attribution.control_models import BeamDrift
from hydrabeam_mpi.loop.selection.acceptance import Checked, Round
from hydrabeam_mpi.loop.selection.history import History
from tests.loop.made import checked, effect_candidate, round_of


def at(log_density: float) -> Checked:
    """A fit that predicts the held-out data with this ln density beside one of zero."""
    return checked(1.0, log_spread=-log_density)


def control(log_bayes_factor: float, before: Checked, after: Checked) -> Round:
    return round_of(effect_candidate(BeamDrift(), log_bayes_factor), before, after)


def test_the_last_search_tells_of_the_control_model() -> None:
    """The one before knew another prior of the beam, with which all is predicted worse."""
    stated, adapted = at(0.0), at(200.0)
    history = History(stated, stated)
    history.compare(control(37.0, stated, at(10.0)))
    assert history.control is not None
    history.last = adapted
    again = control(120.0, adapted, at(220.0))
    history.compare(again)
    assert history.control is again


def test_a_control_model_that_effects_surpass_is_left_out() -> None:
    before, after = at(0.0), at(50.0)
    history = History(before, before)
    history.compare(control(100.0, before, at(20.0)))
    assert history.control is not None
    found = round_of(effect_candidate(AntennaGains(), 90.0), before, after)
    history.rounds, history.last = [found], after
    history.compare(None)
    assert history.control is None
