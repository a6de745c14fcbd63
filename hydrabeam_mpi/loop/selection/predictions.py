"""What a fit predicts of the held-out rows."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import BrokenOff
from hydrabeam_mpi.fit.heldout import Whitened, whiten
from hydrabeam_mpi.fit.predicted_power import squares_of_model
from hydrabeam_mpi.fit.state import Fitted
from hydrabeam_mpi.inference.significance import SIGNIFICANT_P, sigma_of_log_p
from hydrabeam_mpi.loop.residuals.remains import remains_of
from hydrabeam_mpi.loop.selection.acceptance import Checked
from hydrabeam_mpi.loop.selection.heldout_numbers import HeldoutNumbers, heldout_numbers
from hydrabeam_mpi.loop.selection.heldout_score import HeldoutScore, heldout_score

BEYOND = "what it predicts of held-out data is beyond all numbers"
"""Why a fit has no prediction."""


def check(context: FitContext, fitted: Fitted) -> Checked:
    """Predict the held-out rows. Collective: all ranks of the grid.

    Raises
    ------
    BrokenOff
        On all ranks, where what is predicted is beyond all numbers.
    """
    with _in_numbers():
        remains, score = remains_of(context, fitted, _predicted(context, fitted)), heldout_score(context, fitted)
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
    """Predict the held-out rows, and tell no more of it than how well; otherwise as `check`. Collective: all ranks."""
    with _in_numbers():
        _predicted(context, fitted)
        return heldout_score(context, fitted)


@contextmanager
def _in_numbers() -> Iterator[None]:
    """Take matrices that cannot be factored, as predictions were too large, for what they are."""
    try:
        yield
    except InputError as error:
        raise BrokenOff(BEYOND) from error


def _predicted(context: FitContext, fitted: Fitted) -> Whitened:
    """Return the held-out residuals if all are numbers in single precision, in which ranks exchange them.

    What drifts may grow without end where nothing was fitted.
    """
    whitened = whiten(context, fitted)
    # Also false of what is no number.
    finite = bool(np.all(np.abs(whitened.z[whitened.used]) < np.finfo(np.float32).max))
    if not all(context.grid.world.allgather(finite)):
        raise BrokenOff(BEYOND)
    return whitened
