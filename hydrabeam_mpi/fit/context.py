"""Where a fit works: the ranks, the problem and a rank's rows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray, IntArray
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.fit.blocks import BeamBlock
from hydrabeam_mpi.fit.carried_over import CarriedOver
from hydrabeam_mpi.fit.learned import Learned
from hydrabeam_mpi.fit.rank_data import RankData
from hydrabeam_mpi.fit.shares import read_share
from hydrabeam_mpi.fit.state import Values
from hydrabeam_mpi.inference.prior import ChannelPrior
from hydrabeam_mpi.mpi import ProcessGrid
from hydrabeam_mpi.setup.problem import Problem

T = TypeVar("T")


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
    carried : CarriedOver, optional
        The effects of the result that is the prior, as these data have them.
    learned : Learned, optional
        What that result says of them and of the beam given these; None where it has none that hold here.
    """

    grid: ProcessGrid
    problem: Problem
    setup: ObservingSetup
    train: RankData
    test: RankData
    carried: CarriedOver | None = None
    learned: Learned | None = None

    @property
    def channels(self) -> list[int]:
        """The numbers of this rank group's channels."""
        return [int(number) for number in self.problem.channel_numbers]

    @property
    def beam(self) -> BeamBlock:
        """The beam of this rank group's channels."""
        return BeamBlock(self.problem.basis, ChannelPrior(tuple(self.problem.priors)))

    @cached_property
    def exchanged(self) -> FitContext:
        """The same with the fitted and the held-out rows in each other's place.

        The rows that are held out then are read again where the ranks share those of a time, whose errors are whitened
        together. Collective: all ranks of the grid.
        """
        problem = replace(self.problem, train=self.problem.test, test=self.problem.train)
        mine, test = len(self.train.rows.tile.bls), self.train
        if not all(self.grid.world.allgather(mine in (0, len(problem.test.bls)))):
            rows = read_share(self.grid, self.problem, problem.test, True, False)
            test = RankData(self.problem, self.setup, rows, kept_bytes=self.train.kept_bytes)
        return replace(self, problem=problem, train=self.test, test=test)

    def held_out_at(self, times: IntArray) -> FitContext:
        """Return the same with no held-out rows but those of some times, by their numbers in the observation."""
        tile = self.problem.test
        test = replace(tile, times=tile.times[np.isin(tile.times, times)])
        return replace(self, problem=replace(self.problem, test=test), test=self.test.at_times(times))

    def given(self, values: Values) -> Problem:
        """Return the problem of this rank group with the beams' priors given the effects, as wide as the values say."""
        if self.learned is None:
            return self.problem.with_prior_widths(values.prior_widths)
        priors = tuple(self.learned.beam_prior(channel, values) for channel in self.channels)
        return replace(self.problem, priors=priors)

    @cached_property
    def _latest(self) -> dict[str, list[tuple[object, Any]]]:
        return {}

    @cached_property
    def _held(self) -> dict[str, object]:
        return {}

    def of_latest(self, name: str, fitted: object, make: Callable[[], T], kept: int = 1) -> T:
        """Return what ``make`` works out of a fit, by ``name``.

        Those of the latest are ``kept``, by when they were asked for: of one to judge it and again once it has been
        chosen, of several to compare them; and that of a fit which it is to `hold`.
        """
        known = self._latest.get(name, [])
        one = next((one for one in known if one[0] is fitted), None) or (fitted, make())
        ordered = [one, *(other for other in known if other is not one)]
        self._latest[name] = [*ordered[:kept], *(other for other in ordered[kept:] if other[0] is self._held.get(name))]
        found: T = one[1]
        return found

    def hold(self, name: str, fitted: object) -> None:
        """Keep what has been worked out of a fit by ``name``, until another one is to be held."""
        self._held[name] = fitted

    def over_channels(self, values: FloatArray) -> float:
        """Add up what each group has of its channels, (Nlocal,). Collective: all ranks of the grid."""
        mine = float(np.sum(values)) if self.grid.is_group_root else 0.0
        return float(sum(self.grid.world.allgather(mine)))
