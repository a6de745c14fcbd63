"""What is worked out of fits, and kept for when it is asked for again."""

from __future__ import annotations

from pathlib import Path

from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.heldout import hold_prediction, whiten
from hydrabeam_mpi.fit.state import Values
from tests.loop.mock import context_of, mock_job


def test_what_is_held_stays_while_others_are_asked_for(tmp_path: Path) -> None:
    context = context_of(mock_job(), tmp_path)
    best, *others = (refit(context, Values()) for _ in range(4))
    predicted = whiten(context, best)
    assert whiten(context, best) is predicted
    hold_prediction(context, best)
    for one in others:
        assert whiten(context, one) is not predicted
    assert whiten(context, best) is predicted
    # Another one that is held takes its place.
    hold_prediction(context, others[0])
    whiten(context, others[1])
    assert whiten(context, best) is not predicted
