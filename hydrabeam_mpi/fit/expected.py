"""How far off predictions are expected to be, by all that is uncertain of the model."""

from __future__ import annotations

from dataclasses import replace

from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.heldout import Whitened, variance_by_effects
from hydrabeam_mpi.fit.state import Fitted
from hydrabeam_mpi.mpi import together


def with_effects(context: FitContext, fitted: Fitted, whitened: Whitened) -> Whitened:
    """Add to `Whitened.beam` what is uncertain of the effects, row by row. Collective: all ranks of the grid."""
    with together(context.grid.world):
        rows, added = context.test.calibrated(fitted.estimate)
        variance, _ = variance_by_effects(context, fitted, rows, added)
        as_read = context.test.noise_variance(rows) * rows.inv_noise_var
        return replace(whitened, beam=whitened.beam + as_read * variance.sum(axis=1))
