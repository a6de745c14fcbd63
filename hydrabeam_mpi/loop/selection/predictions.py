"""What a fit predicts of the held-out rows."""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.heldout import whiten
from hydrabeam_mpi.fit.predicted_power import squares_of_model
from hydrabeam_mpi.fit.state import Fitted
from hydrabeam_mpi.inference.significance import SIGNIFICANT_P, sigma_of_log_p
from hydrabeam_mpi.loop.residuals.remains import remains_of
from hydrabeam_mpi.loop.selection.acceptance import Checked
from hydrabeam_mpi.loop.selection.heldout_numbers import HeldoutNumbers, heldout_numbers
from hydrabeam_mpi.loop.selection.heldout_score import HeldoutScore, heldout_score


def check(context: FitContext, fitted: Fitted) -> Checked:
    """Predict the held-out rows. Collective: all ranks of the grid."""
    remains, score = remains_of(context, fitted, whiten(context, fitted)), heldout_score(context, fitted)
    numbers = heldout_numbers(context, fitted)
    # That is only asked where the rest may be noise.
    at_noise = remains.consistent and is_at_noise(context, fitted, numbers)
    return Checked(fitted, score, remains, numbers, at_noise)


def is_at_noise(context: FitContext, fitted: Fitted, numbers: HeldoutNumbers) -> bool:
    """Whether the residual has no more power than noise and model give. Collective: all ranks of the grid."""
    most = sigma_of_log_p(float(np.log(SIGNIFICANT_P)))
    # Without what errors of the model are alike in many rows it would be more significant.
    if bool(context.grid.world.bcast(numbers.excess_sigma(0.0) < most)):
        return True
    squares = squares_of_model(context, fitted)
    found = None if squares is None else numbers.excess_sigma(squares) < most
    return bool(context.grid.world.bcast(found))


def score_of(context: FitContext, fitted: Fitted) -> HeldoutScore:
    """Predict the held-out rows, and tell no more of it than how well. Collective: all ranks of the grid."""
    return heldout_score(context, fitted)
