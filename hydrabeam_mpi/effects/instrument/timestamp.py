"""A clock offset: the data were taken a little later, or earlier, than their timestamps say."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.interface.effect import Columns, Parameters
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.shared.displaced import TurningSky, turn_per_second


class Timestamp(TurningSky):
    """The data were taken some seconds later than their timestamps, the same number or one that changes in time.

    The sky is turned about the celestial pole by the Earth's rate times the offset. Sources keep to the model when that
    takes them below the horizon, and none rise (see `effects.displaced`): a rim of 15 arcsec per second.
    """

    kind = "timestamp"
    title = "timestamp offset"
    of_both_feeds = True
    laws: ClassVar = {"smooth": "clock that drifts", "piecewise": "clock that jumps"}

    def parameters(self, setup: ObservingSetup) -> Parameters:
        """Return the one offset."""
        return Parameters.of(["time by which data are later than their timestamps"], "s", 1.0)

    def rotations(self, block: RowBlock, x: FloatArray) -> FloatArray:
        """Return the same rotation for every time, (Ntimes, 3)."""
        return np.tile(x[0] * turn_per_second(block), (len(block.times), 1))

    def slopes(self, block: RowBlock, x: FloatArray) -> Columns:
        """Return what turning on about the pole does; the axis does not depend on ``x``, (n_params,)."""
        values = self.rates(block) @ turn_per_second(block)
        return Columns(values[..., np.newaxis], 1, by_group=True)
