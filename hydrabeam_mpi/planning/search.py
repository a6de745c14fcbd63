"""What the parts of a loop cost on this machine, timed by a loop over a few rows that looks for all effects.

What is certain (the check of conventions, the first fit, all effects weighed once, widths of the beam's prior and what
ends the loop) is told apart from what an effect that is found takes: to be fitted beside its rivals, to be confirmed,
and to have all weighed again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr
from dataclasses import dataclass, field, replace
from functools import cached_property
from io import StringIO

from hydrabeam_mpi.fit.clock import Clock as Phases
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.joint import channel_results
from hydrabeam_mpi.fit.room import Room
from hydrabeam_mpi.fit.state import Values
from hydrabeam_mpi.loop.attribution.control_models import control_models
from hydrabeam_mpi.loop.checks.conventions import check_conventions
from hydrabeam_mpi.loop.selection.choice import choose
from hydrabeam_mpi.loop.selection.history import History
from hydrabeam_mpi.loop.selection.prior_widths import adapt
from hydrabeam_mpi.loop.selection.rounds import Search, begin, run_rounds, settle_last
from hydrabeam_mpi.planning.measure import Bench, Cost
from hydrabeam_mpi.planning.outline import Clock


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
    _found: dict[str, list[float]] = field(default_factory=dict)

    @cached_property
    def contexts(self) -> list[FitContext]:
        """The few rows of the bench, of which as much is kept as in the run."""
        return [self._anew(one) for one in self.bench.contexts]

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
        """All effects weighed for the first time."""
        return self._cost("attribution")

    @cached_property
    def trials(self) -> Cost:
        """The best effects fitted beside their rivals, and what is found confirmed by the held-out rows."""
        return self._cost("trials")

    @cached_property
    def end(self) -> Cost:
        """The last fit until nothing moves, and what is told of it."""
        return self._cost("end")

    @cached_property
    def prior_s(self) -> float:
        """Seconds in which a channel's best widths of the prior are found and tried; they hardly hang on the rows."""
        context, history = self._anew(self.contexts[1]), self._histories[1]
        return self.bench.timed(lambda: adapt(context, history.first, 0, wider=False))

    def _cost(self, part: str) -> Cost:
        _ = self._histories
        return self.bench.cost_of(self.contexts, self._found[part])

    @cached_property
    def _histories(self) -> list[History]:
        """Loops that add one effect, of which the parts are timed."""
        return [self._loop(one) for one in self.contexts]

    def _loop(self, context: FitContext) -> History:
        job = context.problem.job
        one = {
            "loop": job.loop.model_copy(update={"max_rounds": 1}),
            "prior": job.prior.model_copy(update={"widths": "stated"}),
        }
        context = replace(context, problem=replace(context.problem, job=job.model_copy(update=one)))
        choice, laps = choose(job, context.setup), Laps(self.bench.clock)
        found: list[History] = []
        self._add("fit", lambda: found.append(begin(context, Values(), Phases())))
        (history,) = found
        effects = [*choice.effects, *control_models(context.setup)]
        search = Search(context, history, effects, choice.changes, laps, lambda _: None)
        with redirect_stderr(StringIO()):
            run_rounds(search)
        self._found.setdefault("attribution", []).append(laps.laps["attribution"][0])
        self._found.setdefault("trials", []).append(sum(laps.laps["trials"]))

        def end() -> None:
            settle_last(context, history)
            channel_results(context, history.last.fitted)

        self._add("end", end)
        return history

    def _add(self, part: str, work: Callable[[], object]) -> None:
        self._found.setdefault(part, []).append(self.bench.timed(work))

    def _anew(self, context: FitContext) -> FitContext:
        """Return the same rows, of which nothing has been worked out yet."""
        train, test = (type(one)(one.problem, one.setup, one.rows) for one in (context.train, context.test))
        train.room = test.room = self.room
        return replace(context, train=train, test=test)
