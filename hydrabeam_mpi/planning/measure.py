"""What the steps of a job cost on this machine: each is timed on a few of its rows, whose number is varied.

A step takes ``fixed + times (by_time + by_group groups)`` seconds: what is done once a channel, such as solving for the
coefficients; once a time, such as evaluating the basis at its sources; and once a row, such as fringes and products.
What is decided once for all channels adds to that.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import redirect_stderr
from dataclasses import dataclass, replace
from functools import cached_property, partial
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from hydrabeam_mpi.fit.accumulate import accumulate, check_heldout
from hydrabeam_mpi.fit.channels import ChannelResult, reduced_chi2, solve_channels
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.io.beamfits import write_power_beam
from hydrabeam_mpi.planning.coupled import SolvedTogether, solved_together
from hydrabeam_mpi.planning.outline import Clock, Outline
from hydrabeam_mpi.planning.probe import probe
from hydrabeam_mpi.result.describe import describe_channels
from hydrabeam_mpi.result.summary import GRID_AZ, GRID_ZA
from hydrabeam_mpi.sampling.begin import begin as begin_chains
from hydrabeam_mpi.sampling.begin import first_state
from hydrabeam_mpi.sampling.predictive import check_heldout as check_predictions
from hydrabeam_mpi.sampling.state import Chance
from hydrabeam_mpi.sampling.sweep import sweep
from hydrabeam_mpi.sampling.variables import arrays_of

MOST_GROUPS = 400
"""Redundant groups of which a step is timed: products with a few hundred rows run as fast as with more."""
FEWER = 4
"""How many times fewer groups, and times, there are where their number is varied."""
TIMES = 4, 16
"""Least and most times of which a step is timed: what is done once for all is then told from what is done at each. The
more they are the less is left to extrapolate, and all those of a small array take no longer than a few of a large one.
"""
MOST_INTEGRATED = 5_000_000_000
"""Products of a source, a group and a function of the beam that are summed for as many times: in some seconds."""
DRAWS = 4
"""Of a chain, of which the first ones fill what later ones find in memory."""


@dataclass(frozen=True)
class Cost:
    """Seconds of a step: ``once + channels (fixed + times (by_time + by_group groups))``."""

    fixed: float = 0.0
    by_time: float = 0.0
    by_group: float = 0.0
    once: float = 0.0

    def seconds(self, times: float, groups: float, channels: int = 1) -> float:
        """Return the seconds of some times, in those of mean cost, with some groups."""
        return self.once + channels * (self.fixed + times * (self.by_time + self.by_group * groups))

    def told_once(self, one: float, two: float) -> Cost:
        """Return the same cost of one channel, of which a part is not done again for each further one.

        Parameters
        ----------
        one, two : float
            Seconds of one channel and of two, of the same rows. What is done once a row is done for each.
        """
        once = min(max(2 * one - two, 0.0), self.fixed)
        return replace(self, fixed=self.fixed - once, once=self.once + once)

    @classmethod
    def through(cls, sizes: list[tuple[float, float]], seconds: list[float]) -> Cost:
        """Return the cost that three measurements tell: the first two differ in groups, the last two in times.

        Parameters
        ----------
        sizes : list of (float, float)
            Times and groups of each.
        seconds : list of float
        """
        (few, fewer), (_, groups), (times, _) = sizes
        by_group = max(seconds[1] - seconds[0], 0.0) / (few * (groups - fewer)) if groups > fewer else 0.0
        more = max(seconds[2] - seconds[1], 0.0)
        of_time = more / (times - few) if times > few else seconds[1] / few
        by_group = min(by_group, of_time / groups)
        fixed = max(seconds[2] - times * of_time, 0.0)
        return cls(fixed, of_time - by_group * groups, by_group)


@dataclass
class Bench:
    """Times the steps of a job when they are asked for.

    Attributes
    ----------
    outline : Outline
    clock : callable
        Tells the time in seconds.
    """

    outline: Outline
    clock: Clock

    @cached_property
    def sizes(self) -> list[tuple[int, int]]:
        """Times and groups of three times a few rows: the first two differ in groups, the last two in times."""
        problem = self.outline.problem
        groups = min(problem.redundant.Ngroups, MOST_GROUPS)
        of_time = problem.sky.Nsrc * groups * problem.basis.n_modes
        times = min(len(problem.train.times), max(TIMES[0], min(MOST_INTEGRATED // of_time, TIMES[1])))
        few, fewer = (max(n // FEWER, 1) for n in (times, groups))
        return [(few, fewer), (few, groups), (times, groups)]

    @cached_property
    def contexts(self) -> list[FitContext]:
        """Three times a few rows."""
        return [probe(self.outline.problem, *size) for size in self.sizes]

    def cost(self, step: Callable[[FitContext], object], of_test: bool = False, repeats: int = 2) -> Cost:
        """Time a step on each of the few rows, the least of ``repeats``; those held out count with ``of_test``."""
        seconds = [min(self.timed(partial(step, one)) for _ in range(repeats)) for one in self.contexts]
        return self.cost_of(self.contexts, seconds, of_test)

    def cost_of(self, contexts: Sequence[FitContext], seconds: list[float], of_test: bool = False) -> Cost:
        """Return the cost of a step that took ``seconds`` on each of the few rows."""
        rows = [(one.test if of_test else one.train).rows for one in contexts]
        sizes = [(max(self.outline.times_of(one.tile), 0.1), float(max(len(one.groups), 1))) for one in rows]
        return Cost.through(sizes, seconds)

    def timed(self, work: Callable[[], object]) -> float:
        """Return the seconds that something takes."""
        with redirect_stderr(StringIO()):
            start = self.clock()
            work()
            return self.clock() - start

    @cached_property
    def simulated(self) -> Cost:
        """Visibilities of a given beam."""
        beams = self.outline.problem.beams
        return self.cost(lambda one: one.train.model.visibilities(beams, one.train.rows.tile.times))

    @cached_property
    def design(self) -> Cost:
        """Normal equations of the beam, in the job's precision."""
        precision = np.float32 if self.outline.job.solver.precision == "mixed" else np.float64

        def work(one: FitContext) -> object:
            rows = one.train.rows
            return accumulate(rows, replace(one.train.model, precision=precision), one.problem.basis)

        return self.cost(work)

    @cached_property
    def heldout(self) -> Cost:
        """Predictions of held-out rows."""
        beams, posterior = self.outline.problem.beams, self.result.posterior

        def work(one: FitContext) -> object:
            return check_heldout(one.test.rows, one.test.model, one.problem.basis, [posterior], beams)

        return self.cost(work, of_test=True)

    @cached_property
    def _solved(self) -> tuple[float, ChannelResult]:
        context = self.contexts[1]
        normals = accumulate(context.train.rows, context.train.model, context.problem.basis)
        start = self.clock()
        posterior = solve_channels(context.grid, context.problem, normals)[0][0]
        _ = posterior.covariance
        seconds = self.clock() - start
        rows, model = context.test.rows, context.test.model
        heldout = check_heldout(rows, model, context.problem.basis, [posterior], context.problem.beams)[0]
        return seconds, ChannelResult(normals[0], reduced_chi2(normals[0], posterior), posterior, heldout)

    @property
    def solve_s(self) -> float:
        """Seconds in which a channel's coefficients are solved for, with their covariance."""
        return self._solved[0]

    @cached_property
    def together(self) -> SolvedTogether | None:
        """What it takes rank 0 to solve for beams that hang together."""
        return solved_together(self.outline, self.clock)

    @property
    def result(self) -> ChannelResult:
        """What a few rows say."""
        return self._solved[1]

    @cached_property
    def describe_s(self) -> float:
        """Seconds in which maps, eigenbeams and draws of a channel are made."""
        context = self.contexts[1]
        return self.timed(lambda: describe_channels(context.grid, context.problem, [self.result]))

    @cached_property
    def write_s(self) -> float:
        """Seconds in which the beam is written in another format, which depends little on how many channels it has."""
        freqs, beams = self.outline.problem.observation.freqs, np.ones((1, 1, len(GRID_ZA), len(GRID_AZ)))
        with TemporaryDirectory(prefix="hydrabeam-") as folder:
            path = Path(folder) / "beam.beamfits"
            return self.timed(lambda: write_power_beam(path, beams, freqs, ["ee"], telescope_name="plan"))

    @staticmethod
    def _anew(context: FitContext) -> FitContext:
        """Return the same rows, of which nothing has been worked out yet."""
        train, test = (type(one)(one.problem, one.setup, one.rows) for one in (context.train, context.test))
        return replace(context, train=train, test=test)

    @cached_property
    def begin_chains(self) -> Cost:
        """The joint fit from which chains begin."""
        return self.cost(lambda one: begin_chains(self._anew(one)))

    @cached_property
    def draw(self) -> Cost:
        """One draw of a chain."""

        def work(one: FitContext) -> None:
            walk, state = walks[id(one)]
            for number in range(DRAWS):
                state, _ = sweep(walk, state, Chance(1, 0, number))
                walk.log_likelihood(state)
                arrays_of(walk, state)
                if one.problem.job.sample.heldout:
                    check_predictions(walk, state)

        walks = {}
        with redirect_stderr(StringIO()):
            for one in self.contexts:
                walk = begin_chains(one)
                walks[id(one)] = walk, first_state(walk, 1, 0)
        cost = self.cost(work)
        thin = self.outline.job.sample.thin
        return Cost(*(part * thin / DRAWS for part in (cost.fixed, cost.by_time, cost.by_group)))
