"""How a loop ended, and why it does not explain the data."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hydrabeam_mpi.effects.noise.bad_baselines import BadBaselines
from hydrabeam_mpi.fit.state import Fitted, Reweighted, Values
from hydrabeam_mpi.loop.attribution.control_models import BeamDrift
from hydrabeam_mpi.loop.selection.verdict import verdict_of, why_unexplained
from tests.loop.made import checked, effect_candidate, round_of

WITHOUT_BASELINES = Fitted(Values(reweighted=(Reweighted(BadBaselines(), np.full((1, 3), 5.0), np.zeros((1, 3))),)))
CONTROL = round_of(effect_candidate(BeamDrift()), checked(2.0), checked(1.2))
WHY: list[tuple[str, dict[str, Any], bool, str | None]] = [
    ("calibrated and at the noise", {"chi2": 1.0, "consistent": True}, False, None),
    ("not calibrated", {"chi2": 4.0}, False, "not calibrated: what is left is more than they expect (predictive"),
    ("calibrated, but for one antenna", {"chi2": 1.0, "stands_out": "gains, antenna 24 (4.8 sigma)"}, False,
     "calibrated as a whole (predictive chi^2 1), but what is left is not noise alone: it stands out in gains, ant"),
    ("calibrated as they are wide", {"chi2": 1.0, "consistent": True, "rms": 3.0}, False,
     "calibrated, but only as they are wide: the held-out residual has 3 Jy rms, where the noise has 1 Jy"),
    ("calibrated, and as wide as data leave the beam", {"chi2": 1.0, "consistent": True, "rms": 3.0, "expected": 3.0},
     False, None),
    ("a control model", {"chi2": 1.0, "consistent": True}, True, "a beam that changes in time would explain more"),
    ("what is left out is of unknown origin", {"chi2": 1.0, "consistent": True, "fitted": WITHOUT_BASELINES}, False,
     "the data that carry something unknown are left out, and of all others nothing significant is left"),
]  # fmt: skip


@pytest.mark.parametrize(("given", "control", "words"), [case[1:] for case in WHY], ids=[case[0] for case in WHY])
def test_why_data_stay_unexplained(given: dict[str, Any], control: bool, words: str | None) -> None:
    why = why_unexplained(checked(**given), CONTROL if control else None, 0)
    assert why is None if words is None else words in str(why)


def test_what_a_job_leaves_out_itself_is_no_reason() -> None:
    last = checked(1.0, consistent=True, fitted=WITHOUT_BASELINES)
    assert why_unexplained(last, None, 0) is not None
    assert why_unexplained(last, None, 1) is None


def test_what_is_explained_is_consistent_where_nothing_was_added() -> None:
    assert [verdict_of("not calibrated", added) for added in (True, False)] == ["unexplained", "unexplained"]
    assert [verdict_of(None, added) for added in (True, False)] == ["explained", "consistent"]
