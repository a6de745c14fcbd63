"""Changes of the weights are told again when they do, or say, something else than before."""

from __future__ import annotations

import numpy as np
import pytest

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.interface.reweighting import ReweightingFit
from hydrabeam_mpi.effects.noise.bad_baselines import BadBaselines
from hydrabeam_mpi.fit.state import Reweighted
from hydrabeam_mpi.loop.selection.taken_back import _is_same

STD: FloatArray = np.array([[0.0, 0.1, 0.0]])


@pytest.mark.parametrize(
    ("x", "is_same"),
    [
        pytest.param([1.0, 3.0, 1.0], True, id="as it was"),
        pytest.param([1.0, 3.19, 1.0], True, id="within its errors"),
        pytest.param([1.0, 3.3, 1.0], False, id="beyond its errors"),
        pytest.param([1.0, 3.0, 2.0], False, id="another baseline as well"),
    ],
)
def test_a_change_is_the_same(x: list[float], is_same: bool) -> None:
    change = BadBaselines()
    fit = ReweightingFit(100.0, np.array([[1.0, 3.0, 1.0]]), STD, ("a", "b", "c"), ("",) * 3, 200.0, 1)
    assert _is_same(Reweighted(change, np.array([x]), STD), fit) is is_same
