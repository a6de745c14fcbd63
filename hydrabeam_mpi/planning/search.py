"""What the parts of a loop cost on this machine, timed by a loop over a few rows that looks for all effects.

What is certain (the check of conventions, the first fit, all effects weighed once, widths of the beam's prior and what
ends the loop) is told apart from what an effect that is found takes: to be fitted beside its rivals, to be confirmed,
and to have all weighed again.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stderr
from dataclasses import dataclass, replace
from functools import cached_property
from io import StringIO

from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.interface.reweighting import Reweighting
from hydrabeam_mpi.fit.clock import Clock as Phases
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.joint import channel_results
from hydrabeam_mpi.fit.room import Room
from hydrabeam_mpi.fit.state import Values
from hydrabeam_mpi.loop.attribution.control_models import control_models
from hydrabeam_mpi.loop.checks.conventions import check_conventions
from hydrabeam_mpi.loop.selection.acceptance import Checked
from hydrabeam_mpi.loop.selection.choice import choose
from hydrabeam_mpi.loop.selection.first_and_last import begin, settle_last
from hydrabeam_mpi.loop.selection.prior_widths import adapt
from hydrabeam_mpi.loop.selection.rounds import Search, run_round
from hydrabeam_mpi.loop.selection.weighing import next_of, weigh
from hydrabeam_mpi.planning.measure import Bench, Cost
from hydrabeam_mpi.planning.outline import Clock
from hydrabeam_mpi.planning.probe import departing, probe
from hydrabeam_mpi.setup.problem import Problem

LONGEST_S = 3.0
"""Seconds of what is certain of a loop over few rows. A round that finds an effect takes some ten times as many, and
nobody waits for a forecast as long as for the loop."""


class Laps(Phases):
    """Takes each time of a phase by itself, by a clock of its own."""

    def __init__(self, tell: Clock) -> None:
        super().__init__()
        self._tell = tell
        self.laps: dict[str, list[float]] = {}

    @contextmanager
    def time(self, phase: str) -> Iterator[None]:
        """Add the time that the block takes to those of ``phase``."""
        start = self._tell()
        yield
        self.laps.setdefault(phase, []).append(self._tell() - start)


@dataclass(frozen=True)
class _Begun:
    """What is certain of a loop over few rows: its first fit, what was looked for, and the seconds of each part."""

    context: FitContext
    checked: Checked
    effects: Sequence[Effect]
    seconds: dict[str, float]


@dataclass
class SearchBench:
    """Times the parts of a loop when they are asked for.

    Attributes
    ----------
    bench : Bench
    room : Room
        What a rank keeps of its fitted rows, which a few rows would always have room for.
    """

    bench: Bench
    room: Room

    @cached_property
    def conventions(self) -> Cost:
        """The data compared with the model under each convention."""
        return self.bench.cost(lambda one: check_conventions(one.grid, one.problem, one.train.rows), repeats=1)

    @cached_property
    def fit(self) -> Cost:
        """A first fit, with its predictions; its design is made anew."""
        return self._cost("fit")

    @cached_property
    def attribution(self) -> Cost:
        """All effects weighed, where there is none to find."""
        return self._cost("attribution")

    @cached_property
    def end(self) -> Cost:
        """The last fit until nothing moves, and what is told of it."""
        return self._cost("end")

    @cached_property
    def prior(self) -> Cost:
        """Widths of the beam's prior found and tried, as wide as stated or wider, and as the data want.

        They hardly hang on the rows.
        """
        one = self._of_prior(self._clean[-1])
        cost = Cost(fixed=one)
        return cost.told_once(one, self._of_prior(self._pair)) if self._pair else cost

    @property
    def longer(self) -> float:
        """How many times as long all effects are weighed where there is something to find.

        The more an effect explains the more parts of it are told from each other, and what explains as much; and those
        that have evidence are weighed together.
        """
        return self._faulty["attribution"] / self._clean[self._of_round].seconds["attribution"]

    @property
    def fits(self) -> float:
        """How many times as long as the first fit the best effects are fitted beside their rivals, and confirmed."""
        return self._faulty["trials"] / self._clean[self._of_round].seconds["fit"]

    def _cost(self, part: str) -> Cost:
        seconds = [one.seconds[part] for one in self._clean]
        cost = self.bench.cost_of([one.context for one in self._clean], seconds)
        return cost.told_once(seconds[-1], self._pair.seconds[part]) if self._pair else cost

    @cached_property
    def _clean(self) -> list[_Begun]:
        """Loops over few rows in which no effect is to be found."""
        return [self._begun(self._rows(self.bench.outline.problem, size, False)) for size in self.bench.sizes]

    @cached_property
    def _pair(self) -> _Begun | None:
        """The same of the most rows in two channels, if there are several."""
        problem = self.bench.outline.pair
        return None if problem is None else self._begun(self._rows(problem, self.bench.sizes[-1], False))

    def _begun(self, context: FitContext) -> _Begun:
        """Do what is certain of a loop."""
        laps, effects, changes = Laps(self.bench.clock), *self._wanted(context)
        with redirect_stderr(StringIO()):
            history = begin(context, Values(), laps)
            with laps.time("attribution"):
                weigh(context, history.last.fitted, effects, changes, 0)
            checked = history.last
            with laps.time("end"):
                settle_last(context, history)
                channel_results(context, history.last.fitted)
        return _Begun(context, checked, effects, {name: sum(taken) for name, taken in laps.laps.items()})

    def _of_prior(self, begun: _Begun) -> float:
        """Return the seconds in which the beam's prior is adapted, once and again as `run_search` does it."""
        context = begun.context
        if self.bench.outline.coupling is not None:
            return 0.0  # the job's own prior is of beams that hang together

        def work() -> None:
            found = adapt(context, begun.checked, 0, True, begun.effects)
            last = begun.checked if found is None else found.after
            adapt(context, last, 0, False, next_of(context, begun.effects, last.fitted.values))

        return self.bench.timed(work)

    @cached_property
    def _of_round(self) -> int:
        """On which of the few rows a round is timed: the most on which it does not take minutes."""
        quick = [n for n, one in enumerate(self._clean) if sum(one.seconds.values()) < LONGEST_S]
        return quick[-1] if quick else 0

    @cached_property
    def _faulty(self) -> dict[str, float]:
        """Seconds of a round that finds an effect."""
        context = self._rows(self.bench.outline.problem, self.bench.sizes[self._of_round], True)
        laps, (effects, changes) = Laps(self.bench.clock), self._wanted(context)
        with redirect_stderr(StringIO()):
            history = begin(context, Values(), laps)
            run_round(Search(context, history, effects, changes, laps, lambda _: None))
        return {name: sum(taken) for name, taken in laps.laps.items()}

    @staticmethod
    def _wanted(context: FitContext) -> tuple[list[Effect], list[Reweighting]]:
        """Return what is looked for."""
        choice = choose(context.problem.job, context.setup)
        return [*choice.effects, *control_models(context.setup)], choice.changes

    def _rows(self, problem: Problem, size: tuple[int, int], faulty: bool) -> FitContext:
        """Return a few rows of a beam that departs from its model, of which as much is kept as in the run.

        Over those in which one antenna is wrong a loop takes one round.
        """
        context, job = probe(problem, *size, departing(problem), faulty), problem.job
        context.train.room = context.test.room = self.room
        if not faulty:
            return context
        one = {
            "loop": job.loop.model_copy(update={"max_rounds": 1}),
            "prior": job.prior.model_copy(update={"widths": "stated"}),
        }
        return replace(context, problem=replace(context.problem, job=job.model_copy(update=one)))
