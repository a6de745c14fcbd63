"""A settled fit is the same whichever way it came there."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from hydrabeam_mpi.effects.instrument.antenna_gains import AntennaGains
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.settle import refined, settle
from hydrabeam_mpi.fit.state import Values
from tests.fit.test_gauss_newton import GAINS, free
from tests.loop.mock import context_of, mock_job


def test_other_starts_end_at_the_same_place(tmp_path: Path) -> None:
    context = context_of(mock_job({"kind": "antenna_gains", "parameters": GAINS}, n_times=6), tmp_path)
    without = settle(context, refit(context, Values()))
    assert without.values == Values()
    fitted = refit(context, Values((free(context, AntennaGains(), 0.1),)))
    (active,), std = fitted.values.active, fitted.fit.std[0]
    again = refined(fitted).values.active[0]
    assert again.effect is active.effect
    np.testing.assert_array_equal(again.used, active.used)
    away = 0.5 * std * np.where(np.arange(std.shape[1]) % 2, 1.0, -1.0)
    ends = []
    for start in (active.x, active.x + away):
        one = replace(fitted, values=Values((replace(active, x=start),)))
        ends.append(settle(context, one))
    one, two = ends
    assert np.abs(one.values.active[0].x - active.x).max() < 0.03 * std.max()
    assert np.all(np.abs(two.values.active[0].x - one.values.active[0].x) <= 1e-6 * std)
    for beam, other in zip(one.fit.posteriors, two.fit.posteriors, strict=True):
        assert np.all(np.abs(other.mean - beam.mean) <= 1e-6 * beam.std)
