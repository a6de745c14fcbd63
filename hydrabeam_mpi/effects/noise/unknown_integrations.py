"""A few integrations with a signal that redundant baselines share: of the sky, or from afar.

It may be interference, or a satellite; or whatever else sky and beam lack that shows in them alone: a skyline, say,
that hides a bright source for the time of one integration.
"""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray
from hydrabeam_mpi.effects.interface.reweighting import std_of_more
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.noise.bad_integrations import BadIntegrations
from hydrabeam_mpi.random import complex_normal


class UnknownIntegrations(BadIntegrations):
    """Integrations to leave out, as they have what redundant baselines share and no effect describes.

    The parameters of a channel are the noise scales of all integrations: one for those that are as they should be.
    """

    kind = "unknown_integrations"
    title = "integrations with an unknown signal"
    is_of_unknown = True
    have_signal = True

    def inject(self, data: ComplexArray, block: RowBlock, x: FloatArray, rng: np.random.Generator) -> ComplexArray:
        """Add a signal of variance (s^2 - 1) sigma^2 that redundant baselines share, (Ntimes, Nbls)."""
        more = self.scales(block.setup, block.times, block.bls, x) ** 2 - 1
        signal = complex_normal(rng, (len(block.times), len(block.groups)))
        return data + std_of_more(block, more) * signal[:, block.member]
