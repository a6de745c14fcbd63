"""Coupling of autocorrelations into the baselines: E_ij = eps_ij* V_ii + eps_ji V_jj."""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.shared.beam_visibilities import beam_visibilities
from hydrabeam_mpi.effects.shared.per_baseline import PerBaseline


class AutoCoupling(PerBaseline):
    """The fraction of each antenna's voltage that another antenna hears, through cables or the air.

    With eps_ij the fraction of antenna i's voltage that antenna j receives (Kern et al. 2019), V_ij has the excess
    eps_ij* V_ii + eps_ji V_jj. Antennas with the same beam have the same autocorrelation, so that no data tell eps_ij*
    from eps_ji: the parameter is their sum, one complex number a baseline and channel. The autocorrelation is that of
    the sky model seen by the current beam; what the receivers' own noise adds is constant, and is cross-coupling.

    The autocorrelation costs an evaluation of the beam at all sources above the horizon, once a block.
    """

    kind = "auto_coupling"
    title = "coupling of autocorrelations"
    linear = True
    scale = 1e-3

    def not_applicable(self, setup: ObservingSetup) -> str | None:
        """Ask for equal feeds and several times."""
        if not setup.observation.is_copolar:
            return "the autocorrelations that couple are those of equal feeds, such as 'ee'; the model has none"
        if len(setup.times) < 2:
            return "what varies as the autocorrelation shows only at several times; there is one"
        return None

    def signature(self, block: RowBlock) -> FloatArray:
        """Return the model's autocorrelation, Jy, (Ntimes, 1)."""
        return beam_visibilities(block, np.zeros((1, 3))).real
