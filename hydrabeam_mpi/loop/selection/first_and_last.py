"""The fit before the first round, and the one after the last."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.fit.clock import Clock
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import BrokenOff, refit
from hydrabeam_mpi.fit.settle import refined, settle
from hydrabeam_mpi.fit.state import Values
from hydrabeam_mpi.io.finite import INFERENCE
from hydrabeam_mpi.loop.selection.history import History
from hydrabeam_mpi.loop.selection.known_beforehand import with_what_is_known
from hydrabeam_mpi.loop.selection.predictions import check
from hydrabeam_mpi.loop.selection.prior_widths import adapt_to_model
from hydrabeam_mpi.loop.selection.weighing import next_of


def begin(context: FitContext, values: Values, clock: Clock, effects: Sequence[Effect] = ()) -> History:
    """Fit what is known before the first round, in which ``effects`` will be looked for. Collective: all ranks.

    Raises
    ------
    InputError
        If the data cannot be predicted.
    """
    with clock.time("fit"):
        with _told_in_a_line():
            checked = check(context, refit(context, with_what_is_known(context, values)))
        history = History(checked, checked)
        adapted = adapt_to_model(context, checked, next_of(context, effects, checked.fitted.values))
    if adapted is not None:
        history.adapt(adapted)
    return history


def settle_last(context: FitContext, history: History) -> None:
    """Go on with the last fit until nothing moves, so that what is written of it can be computed again.

    Effects are described by what has been fitted first. Errors are those of `begin`. Collective: all ranks of the grid.
    """
    n_known = len(context.learned.values.active) if context.learned else 0
    with _told_in_a_line():
        last = check(context, settle(context, refined(history.last.fitted, n_known)))
    history.last = last
    if history.rounds:
        history.rounds[-1] = replace(history.rounds[-1], after=last)
    else:
        history.first = last


@contextmanager
def _told_in_a_line() -> Iterator[None]:
    """Say in a line why a fit that no other stands in for predicts nothing: what is behind that, where it says more."""
    try:
        yield
    except BrokenOff as why:
        if isinstance(why.__cause__, InputError):
            raise why.__cause__ from None
        raise InputError(str(why), field="held-out data", remedy=INFERENCE) from why
