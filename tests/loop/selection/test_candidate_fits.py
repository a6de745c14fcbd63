"""What held-out rows say of an effect that the fitted ones cannot."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hydrabeam_mpi.effects.registry import make_effect
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.state import Active, Values
from hydrabeam_mpi.loop.selection.acceptance import Checked
from hydrabeam_mpi.loop.selection.candidate_fits import by_heldout
from hydrabeam_mpi.loop.selection.predictions import check, score_of
from tests.loop.mock import context_of, mock_job


def jumping(context: FitContext, jumps: list[float], names: list[str]) -> Checked:
    """Fit a model in which the gains of some antennas jump at some times."""
    effect = make_effect("antenna_gains", {"law": "piecewise", "jumps": jumps})
    parameters = effect.parameters(context.setup).names
    wanted = np.array([any(one.startswith(name) for name in names) for one in parameters])
    start = Active.start(effect, context.setup, np.where(wanted, 0.1**2, 0.0), np.zeros((1, len(wanted))))
    return check(context, refit(context, Values((start,))))


def test_jumps_are_placed_by_the_held_out_times_between_the_fitted_ones(tmp_path: Path) -> None:
    """Two belong before a held-out time, and one where it is."""
    times = context_of(mock_job(n_times=24), tmp_path / "without").setup.observation.times
    # Times 2, 5, 8 and so on are held out: a jump is before one of these, or after it.
    true = [float(0.5 * (times[k - 1] + times[k])) for k in (5, 11, 18)]
    settings = {"law": "piecewise", "jumps": true}
    sizes = {f"antenna {ant} phase, jump at JD {jd:.5f}": 0.05 for ant, jd in zip((1, 3, 4), true, strict=True)}
    injected = {"kind": "antenna_gains", "settings": settings, "parameters": sizes}
    context = context_of(mock_job(injected, n_times=24), tmp_path / "with")
    assert not set(context.problem.train.times) & {5, 11, 17}
    given = [float(0.5 * (times[k - 1] + times[k])) for k in (6, 12, 18)]
    checked = jumping(context, given, ["antenna 1 ph", "antenna 3 ph", "antenna 4 ph"])
    placed = by_heldout(context, checked.fitted)
    law = placed.values.active[0].effect.describe()
    np.testing.assert_allclose(law["jumps"], true, rtol=0, atol=1e-9)
    assert score_of(context, placed).log_density > checked.score.log_density + 100
    # Where all are right none moves.
    assert by_heldout(context, placed) is placed
