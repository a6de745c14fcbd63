"""What a fit predicts of the held-out rows."""

from __future__ import annotations

from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.heldout import whiten
from hydrabeam_mpi.fit.state import Fitted
from hydrabeam_mpi.loop.residuals.remains import remains_of
from hydrabeam_mpi.loop.selection.acceptance import Checked
from hydrabeam_mpi.loop.selection.heldout_numbers import heldout_numbers
from hydrabeam_mpi.loop.selection.heldout_score import HeldoutScore, heldout_score


def check(context: FitContext, fitted: Fitted) -> Checked:
    """Predict the held-out rows. Collective: all ranks of the grid."""
    remains = remains_of(context, fitted, whiten(context, fitted))
    return Checked(fitted, heldout_score(context, fitted), remains, heldout_numbers(context, fitted))


def score_of(context: FitContext, fitted: Fitted) -> HeldoutScore:
    """Predict the held-out rows, and tell no more of it than how well. Collective: all ranks of the grid."""
    return heldout_score(context, fitted)
