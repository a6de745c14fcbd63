"""What a draw predicts at held-out rows, and how well: the posterior predictive check, draw by draw."""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.fit.state import Estimate
from hydrabeam_mpi.mpi import allreduce_sum, together
from hydrabeam_mpi.sampling.heldout import CHI2, LOG_DENSITY, RMS
from hydrabeam_mpi.sampling.noise import log_densities, squared_residuals
from hydrabeam_mpi.sampling.state import ChainState
from hydrabeam_mpi.sampling.walk import Walk


def check_heldout(walk: Walk, state: ChainState) -> dict[str, float]:
    """Compare held-out rows with a draw's prediction C (A b + E). Collective: the chain's ranks.

    Returns
    -------
    dict of str to float
        Over all channels: rms of the residuals in Jy, chi^2 by the stated noise over the number of data, and
        ln p(held-out rows | draw) by the draw's noise. Nothing where no rows are held out.
    """
    context, share = walk.context, walk.context.test
    with together(context.grid.world):
        stated, of_read = squared_residuals(share, Estimate(state.values, walk.as_posteriors(state.beams)))
        factor = 1 / (state.noise[:, np.newaxis, np.newaxis] * walk.scale_of(share, state))
        used = of_read > 0
        power = np.divide(stated, of_read, out=np.zeros_like(stated), where=used)
        log_density = log_densities(stated * factor, of_read * factor, walk.dof)
        sums = np.array([one.sum(axis=(1, 2)) for one in (used, power, stated, log_density)], dtype=float)
    allreduce_sum(context.grid.group, sums)
    n, power_sum, chi2, told = (context.over_channels(one) for one in sums)
    return {RMS: float(np.sqrt(power_sum / n)), CHI2: chi2 / n, LOG_DENSITY: told} if n else {}
