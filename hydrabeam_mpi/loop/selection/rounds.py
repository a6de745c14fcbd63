"""The rounds: weigh all effects, try the best, keep it if held-out data agree, until nothing is left to find."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.interface.reweighting import Reweighting
from hydrabeam_mpi.fit.clock import Clock
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.settle import refined, settle
from hydrabeam_mpi.fit.state import Fitted, Values
from hydrabeam_mpi.loop.attribution.constancy import Constancy
from hydrabeam_mpi.loop.attribution.score_noise import WeightsFound
from hydrabeam_mpi.loop.selection.acceptance import Candidate, Checked, Round
from hydrabeam_mpi.loop.selection.constant import beside_noise, take_back, take_back_unphysical, take_back_weights
from hydrabeam_mpi.loop.selection.exchange import exchange
from hydrabeam_mpi.loop.selection.predictions import check
from hydrabeam_mpi.loop.selection.revision import revise
from hydrabeam_mpi.loop.selection.trials import try_control, try_effects
from hydrabeam_mpi.loop.selection.weighing import Outlook, Together, Weighed, next_of, weigh
from hydrabeam_mpi.terminal.progress import say


@dataclass
class History:
    """How the loop went.

    Attributes
    ----------
    first, last : Checked
        Before the first and after the last round.
    rounds : list of Round
    tried : list of (Candidate, str)
        Candidates that had the evidence but were refused by the held-out data, with the reason.
    ranking : tuple of Candidate
        Of the last search, in which nothing more was found.
    control : Round, optional
        Control model that explains the data better than all that was found since; not added.
    control_since : int
        How many rounds there were before it.
    rest : Together, optional
        What is still to be tried of effects that explain the residual together.
    claimed : Checked, optional
        Fit of what is claimed alone, where the last one has more for prediction; see `selection.for_prediction`.
    """

    first: Checked
    last: Checked
    rounds: list[Round] = field(default_factory=list)
    tried: list[tuple[Candidate, str]] = field(default_factory=list)
    ranking: tuple[Candidate, ...] = ()
    control: Round | None = None
    control_since: int = 0
    rest: Together | None = None
    claimed: Checked | None = None

    def add(self, found: Round, places: Mapping[int, int | None]) -> None:
        """Add a round, by which effects are at other ``places`` of the model than before, or taken back (None)."""
        self.rounds = [
            one if one.place is None else replace(one, place=places[one.place]) for one in (*self.rounds, found)
        ]
        self.rounds = [_as_in_model(one, found.after.fitted) for one in self.rounds]
        self.last = found.after

    def tell_again(self, found: Mapping[str, WeightsFound]) -> None:
        """Tell changes of the weights, by kind, as they have been ``found`` since."""
        for number, one in enumerate(self.rounds):
            if one.candidate.kind in found and one.candidate.weights is not None:
                weights = found[one.candidate.kind]
                candidate = replace(one.candidate, weights=weights, log_bayes_factor=weights.fit.log_bayes_factor)
                self.rounds[number] = replace(one, candidate=candidate)

    def compare(self, control: Round | None) -> None:
        """Take note of a control model of the last search, or leave out one that all that was found since surpasses."""
        if control is not None and self.control is None:
            self.control, self.control_since = control, len(self.rounds) - (control.before is not self.last)
        if self.control is None:
            return
        since = self.rounds[self.control_since :]
        evidence = sum(one.candidate.log_bayes_factor for one in since if not one.revoked)
        ahead = self.control.candidate.log_bayes_factor - evidence
        if not ahead + self.control.after.score.log_density - self.last.score.log_density > 0:
            self.control = None


def begin(context: FitContext, values: Values, clock: Clock) -> History:
    """Fit what is known before the first round. Collective: all ranks of the grid."""
    with clock.time("fit"):
        checked = check(context, refit(context, values))
    return History(checked, checked)


def settle_last(context: FitContext, history: History) -> None:
    """Go on with the last fit until nothing moves, so that what is written of it can be computed again.

    Effects are described by what has been fitted first. Collective: all ranks of the grid.
    """
    n_known = len(context.learned.values.active) if context.learned else 0
    last = check(context, settle(context, refined(history.last.fitted, n_known)))
    history.last = last
    if history.rounds:
        history.rounds[-1] = replace(history.rounds[-1], after=last)
    else:
        history.first = last


def run_rounds(
    context: FitContext,
    history: History,
    effects: Sequence[Effect],
    changes: Sequence[Reweighting],
    clock: Clock,
    keep: Callable[[History], None],
) -> None:
    """Look for effects until no further one improves the model.

    Collective: all ranks of the grid.

    Parameters
    ----------
    context : FitContext
    history : History
        So far; it goes on.
    effects, changes
        To look for.
    clock : Clock
        Receives the phases "attribution", "trials" and "keep".
    keep : callable
        Gets the history before the first round, once more when all has been weighed in it, and after each round that
        has found something.
    """
    most, checked = context.problem.job.loop.max_rounds, history.last
    speaks = context.grid.is_world_root
    effects = next_of(context, effects, checked.fitted.values)
    known: Weighed | None = None
    told: Checked | None = None
    while True:
        number = len(history.rounds)
        if not history.rounds:
            _keep(clock, keep, history)
        say(f"round {number + 1}: {_heldout(checked)}; weighing effects", speaks and checked is not told)
        told = checked
        rest, history.rest = history.rest if number < most else None, None
        if rest is not None:
            known = Weighed.next_of(rest)
        with clock.time("attribution"):
            weighed = known or weigh(context, checked.fitted, effects, changes, most - number)
        outlook, known = Outlook(context, effects, changes, most - number, weighed), None
        history.ranking = weighed.ranking
        if not history.rounds:
            _keep(clock, keep, history)
        if number >= most:
            break
        tried: list[tuple[Candidate, str]] = []
        with clock.time("trials"):
            added = try_effects(context, checked, weighed.ranking, tried, outlook=outlook)
            if rest is not None and (added is None or not weighed.is_of_use(added.candidate)):
                say("    all effects are weighed again: those that were to come next are not what was expected", speaks)
                continue  # what was weighed beside others is weighed again with these in the model
            history.tried += tried
            control = try_control(context, checked, weighed.ranking, added)
            if added is None:
                added = _exchanged(context, history, effects)
            else:
                added = replace(added, together=weighed.together.members)
                history.rest = weighed.after(added.candidate)
            if added is not None:
                added = _accept(context, history, added)
            checked = history.last
        history.compare(control)
        if added is None:
            break
        effects, known = next_of(context, effects, added.after.fitted.values), outlook.after(added.after.fitted)
        _keep(clock, keep, history)
    with clock.time("trials"):
        _take_back(context, history)


def _accept(context: FitContext, history: History, added: Round) -> Round:
    """Add a round once all that was found before is weighed again; return it. Collective: all ranks of the grid."""
    given = history.first.fitted.values
    added, places = revise(context, added, len(given.active))
    added, told = beside_noise(context, added, len(given.reweighted))
    history.add(added, places)
    history.tell_again(told)
    return added


def _exchanged(context: FitContext, history: History, effects: Sequence[Effect]) -> Round | None:
    """Exchange an effect for a better one where there is one; return the round. Collective: all ranks of the grid."""
    found = exchange(context, history.last, history.rounds, effects, history.tried)
    if found is None:
        return None
    added, places = found
    history.rounds = [_asked(one, history.last.fitted, places, {}) for one in history.rounds]
    history.add(added, places)
    return history.rounds.pop()


def _keep(clock: Clock, keep: Callable[[History], None], history: History) -> None:
    with clock.time("keep"):
        keep(history)


def _take_back(context: FitContext, history: History) -> None:
    """Take back what is unphysical, not the same in all parts or explained since, until nothing is left of it.

    Collective: all ranks of the grid.
    """
    given, before = history.first.fitted.values, None
    n_given, there = len(given.active), [one.place is not None for one in history.rounds]
    while history.rounds and history.last is not before:
        before = history.last
        for step in (take_back_unphysical, take_back):
            fitted = history.last.fitted
            if len(fitted.values.active) > n_given:
                last, places, asked = step(context, history.rounds[-1], n_given)
                told = [_asked(one, fitted, places, asked) for one in (*history.rounds[:-1], last)]
                history.rounds = told[:-1]
                history.add(told[-1], places)
        last, gone = take_back_weights(context, history.rounds[-1], len(given.reweighted))
        if gone:
            history.rounds = [
                replace(one, given_up=one.given_up or one.candidate.kind in gone)
                for one in (*history.rounds[:-1], last)
            ]
            history.last = last.after
    history.rounds = [
        replace(one, given_up=one.given_up or (was and one.revoked))
        for was, one in zip(there, history.rounds, strict=True)
    ]


def _as_in_model(one: Round, last: Fitted) -> Round:
    """Return a round with its effect as that is in the model now: sources that varied may have been found constant."""
    if one.place is None or one.candidate.finding is None:
        return one
    effect = last.values.active[one.place].effect
    if effect.law == one.candidate.law:
        return one
    found = replace(one.candidate.finding, effect=effect)
    return replace(one, candidate=replace(one.candidate, title=effect.title, finding=found))


def _asked(
    one: Round, before: Fitted, places: Mapping[int, int | None], asked: Mapping[int, tuple[Constancy, ...]]
) -> Round:
    """Return a round with what is known of its effect since all were asked, as they were ``before``."""
    if one.place is None:
        return one
    taken_back = None if places[one.place] is not None else (before.values.active[one.place], before.fit.std[one.place])
    return replace(one, taken_back=taken_back, constancy=asked.get(one.place, one.constancy))


def _heldout(checked: Checked) -> str:
    """Tell in a line how well held-out data are predicted, beside the model beam, zero and the noise."""
    now = checked.numbers.of_all
    return (
        f"held-out chi^2 {checked.score.chi2:.4g} (over the noise alone {now['noise_only_chi2']:.4g}), ln density "
        f"{now['log_density']:.6g}, rms {now['rms']:.4g} Jy ({now['explained']:.4%} explained; model beam "
        f"{now['rms_model']:.4g}, with its best scale {now['rms_model_scaled']:.4g}, zero {now['rms_zero']:.4g}, noise "
        f"{now['rms_noise']:.4g} Jy)"
    )
