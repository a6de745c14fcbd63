"""Where a fit works: the ranks, the problem and a rank's rows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.fit.blocks import BeamBlock
from hydrabeam_mpi.fit.rank_data import RankData
from hydrabeam_mpi.inference.prior import ChannelPrior
from hydrabeam_mpi.mpi import ProcessGrid
from hydrabeam_mpi.setup.problem import Problem


@dataclass(frozen=True)
class FitContext:
    """Where a fit works: the ranks, the problem and this rank's rows.

    Attributes
    ----------
    grid : ProcessGrid
    problem : Problem
        Of the rank group's channels.
    setup : ObservingSetup
        Of all channels.
    train, test : RankData
    """

    grid: ProcessGrid
    problem: Problem
    setup: ObservingSetup
    train: RankData
    test: RankData

    @property
    def channels(self) -> list[int]:
        """The numbers of this rank group's channels."""
        return [int(number) for number in self.problem.channel_numbers]

    @property
    def beam(self) -> BeamBlock:
        """The beam of this rank group's channels."""
        return BeamBlock(self.problem.basis, ChannelPrior(tuple(self.problem.priors)))

    def over_channels(self, values: FloatArray) -> float:
        """Add up what each group has of its channels, (Nlocal,). Collective: all ranks of the grid."""
        mine = float(np.sum(values)) if self.grid.is_group_root else 0.0
        return float(sum(self.grid.world.allgather(mine)))
