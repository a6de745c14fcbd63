"""What a fit predicts of the held-out rows."""

from __future__ import annotations

from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.heldout import whiten
from hydrabeam_mpi.fit.predicted_power import squares_of_model
from hydrabeam_mpi.fit.state import Fitted
from hydrabeam_mpi.loop.residuals.remains import remains_of
from hydrabeam_mpi.loop.selection.acceptance import Checked
from hydrabeam_mpi.loop.selection.heldout_numbers import HeldoutNumbers, heldout_numbers
from hydrabeam_mpi.loop.selection.heldout_score import HeldoutScore, heldout_score
from hydrabeam_mpi.mpi import together


def check(context: FitContext, fitted: Fitted) -> Checked:
    """Predict the held-out rows. Collective: all ranks of the grid."""
    remains, numbers = remains_of(context, fitted, whiten(context, fitted)), heldout_numbers(context, fitted)
    # Whether the rms is that of noise and model is only asked where the rest may be noise.
    excess = _excess_sigma(context, fitted, numbers) if remains.consistent else float("nan")
    return Checked(fitted, heldout_score(context, fitted), remains, numbers, excess)


def _excess_sigma(context: FitContext, fitted: Fitted, numbers: HeldoutNumbers) -> float:
    """Return by how many sigma the residual has more power than expected. Collective: all ranks of the grid."""
    squares = squares_of_model(context, fitted)
    with together(context.grid.world):
        found = None if squares is None else numbers.excess_sigma(squares)
    return float(context.grid.world.bcast(found))


def score_of(context: FitContext, fitted: Fitted) -> HeldoutScore:
    """Predict the held-out rows, and tell no more of it than how well. Collective: all ranks of the grid."""
    return heldout_score(context, fitted)
