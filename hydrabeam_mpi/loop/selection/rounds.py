"""The rounds: weigh all effects, try the best, keep it if held-out data agree, until nothing is left to find."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.interface.reweighting import Reweighting
from hydrabeam_mpi.fit.clock import Clock
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import BrokenOff
from hydrabeam_mpi.fit.state import Fitted
from hydrabeam_mpi.loop.attribution.constancy import Constancy
from hydrabeam_mpi.loop.attribution.score_effects import attribute
from hydrabeam_mpi.loop.selection.acceptance import Candidate, Checked, Round
from hydrabeam_mpi.loop.selection.beside_model import told_by_model
from hydrabeam_mpi.loop.selection.exchange import exchange
from hydrabeam_mpi.loop.selection.history import History
from hydrabeam_mpi.loop.selection.prior_widths import Adapted, adapt, as_adapted
from hydrabeam_mpi.loop.selection.revision import revise
from hydrabeam_mpi.loop.selection.rivalled import take_back_rivalled
from hydrabeam_mpi.loop.selection.simpler import simplified
from hydrabeam_mpi.loop.selection.taken_back import (
    Taken,
    beside_noise,
    take_back,
    take_back_faint,
    take_back_unphysical,
    take_back_weights,
)
from hydrabeam_mpi.loop.selection.trials import try_control, try_effects
from hydrabeam_mpi.loop.selection.weighing import Outlook, Weighed, next_of, weigh
from hydrabeam_mpi.loop.selection.whole_set import as_one, try_set
from hydrabeam_mpi.mpi import bcast_object
from hydrabeam_mpi.terminal.progress import say

Step = Callable[[FitContext, Round, int], Taken]
"""What takes back effects of the last round, but for the first so many of the model, which the job itself has."""


@dataclass(frozen=True)
class Search:
    """What is looked for, and where it is kept.

    Attributes
    ----------
    context : FitContext
    history : History
        So far; it goes on.
    effects, changes
        To look for.
    clock : Clock
        Receives the phases "attribution", "prior", "trials" and "keep".
    keep : callable
        Gets the history before the first round, once more when all has been weighed in it, and after each round that
        has found something.
    """

    context: FitContext
    history: History
    effects: Sequence[Effect]
    changes: Sequence[Reweighting]
    clock: Clock
    keep: Callable[[History], None]

    def save(self) -> None:
        """Keep the history as it is. Collective: all ranks of the grid."""
        with self.clock.time("keep"):
            self.keep(self.history)


def run_rounds(search: Search) -> None:
    """Look for effects until no further one improves the model. Collective: all ranks of the grid.

    Where a step on the way has no beam that can be solved for, the search ends with what has been found before it.
    """
    context, history = search.context, search.history
    rounds = _Rounds(search, next_of(context, search.effects, history.last.fitted.values))
    try:
        while rounds.go_on():
            pass
        with search.clock.time("trials"):
            _take_back(context, history, rounds.effects)
        rounds.adapt()
    except BrokenOff as why:
        say(f"the search ends with what has been found so far: {why}", context.grid.is_world_root)


def run_round(search: Search) -> bool:
    """Weigh all effects and add the best; whether there is more to look for. Collective: all ranks of the grid."""
    return _Rounds(search, next_of(search.context, search.effects, search.history.last.fitted.values)).go_on()


@dataclass
class _Rounds:
    """Rounds that follow each other.

    ``effects`` come next, ``known`` is what is weighed already before the next round, ``told`` the last fit that was
    told of, ``asked`` the last in which effects were asked whether others should stand in their place, and ``as_wide``
    the last that was asked in vain for wider widths of the beam's prior without rivals to these.
    """

    search: Search
    effects: Sequence[Effect]
    known: Weighed | None = None
    told: Checked | None = None
    asked: Checked | None = None
    as_wide: Checked | None = None

    def go_on(self) -> bool:
        """Weigh all effects and add the best; whether there is more to look for. Collective: all ranks of the grid."""
        context, history = self.search.context, self.search.history
        left = context.problem.job.loop.max_rounds - len(history.rounds)
        if left > 0 and self.told is None and self._try_beside_model():
            return True
        if self._exchange(only_more=left > 0):
            return True
        weighed = self._weighed(left)
        if left <= 0:
            return False
        if self.adapt(weighed.ranking):
            return True
        outlook = Outlook(context, self.effects, self.search.changes, left, weighed)
        tried: list[tuple[Candidate, str]] = []
        with self.search.clock.time("trials"):
            of_set = try_set(context, history.last, weighed, tried)
            best = as_one(of_set) if of_set else None
            added = try_effects(context, history.last, weighed.ranking, tried, best, outlook)
            history.tried += tried
            control = try_control(context, history.last, weighed.ranking, added)
            if added is None:
                added = self._exchanged(or_simpler=True)
            elif added is best:
                for one in of_set[:-1]:
                    history.add(one, {place: place for place in range(len(one.after.fitted.values.active))})
                added = of_set[-1]
            else:
                added = replace(added, together=weighed.together.members)
            if added is not None and (of_beam := as_adapted(context, added, len(history.rounds), self.is_wider)):
                return self._go_on_from(of_beam)
            if added is not None:
                added = _accept(context, history, added)
        history.compare(control)
        if added is None:
            return self.adapt()
        self._keep(added, outlook.after(added.after.fitted))
        self._grow(added)
        return True

    def _try_beside_model(self) -> bool:
        """Try what data say beside the model beam, where that leaves less than a fitted beam; whether it stays.

        Collective: all ranks.
        """
        context, history = self.search.context, self.search.history
        with self.search.clock.time("attribution"):
            candidate = told_by_model(context, history.last.fitted, self.effects)
        if candidate is None:
            return False
        self._tell("beside the model beam less is left")
        with self.search.clock.time("trials"):
            added = try_effects(context, history.last, (candidate,), history.tried)
            added = _accept(context, history, added) if added is not None else None
        if added is not None:
            self._keep(added)
        return added is not None

    def _tell(self, what: str) -> None:
        """Tell how well held-out data are predicted, and what comes next."""
        history = self.search.history
        say(f"round {len(history.rounds) + 1}: {_heldout(history.last)}; {what}", self._speaks)
        self.told = history.last

    @property
    def _speaks(self) -> bool:
        return self.search.context.grid.is_world_root and self.search.history.last is not self.told

    def _exchange(self, only_more: bool) -> bool:
        """Exchange an effect, which adds none; whether one was. Collective: all ranks.

        What was chosen while others were missing may have taken up a part of them. As long as something is left that is
        asked about before more is added to make up for it: for what the linear model says is better (``only_more``),
        which costs no fit where there is none; and for all that may be where no more may be added.
        """
        context, history = self.search.context, self.search.history
        if only_more and (self.asked is history.last or history.last.remains.consistent):
            return False
        self.asked = history.last
        with self.search.clock.time("trials"):
            found = self._exchanged(only_more=only_more)
            added = _accept(context, history, found) if found is not None else None
        if added is not None:
            self._keep(added)
        return added is not None

    def _exchanged(self, or_simpler: bool = False, only_more: bool = False) -> Round | None:
        """Exchange an effect for a better one, or for a simpler one; return the round. Collective: all ranks."""
        context, history = self.search.context, self.search.history
        given = context, history.last, history.rounds, self.effects, history.tried
        found = exchange(*given, only_more, history.adapted) or (simplified(*given) if or_simpler else None)
        if found is None:
            return None
        added, places = found
        history.rounds = [_asked(one, history.last.fitted, places, {}) for one in history.rounds]
        history.add(added, places)
        return history.rounds.pop()

    def _keep(self, added: Round, known: Weighed | None = None) -> None:
        """Go on from a round, with what is ``known`` of what there is to try beside it. Collective: all ranks."""
        self.effects = next_of(self.search.context, self.effects, added.after.fitted.values)
        self.known = known
        self.search.save()

    def _grow(self, added: Round) -> None:
        """Add more of what comes in parts, as long as the data want it. Collective: all ranks of the grid.

        The functions that a basis lacks are as many as one looks for, and so are the directions in which there are
        faint sources: where the most that are looked for at once have been found, there may be more. Others are weighed
        again when there are not, as what is lacking may pass for any of them.
        """
        context, history, clock = self.search.context, self.search.history, self.search.clock
        while len(history.rounds) < context.problem.job.loop.max_rounds:
            parts = bcast_object(context.grid.world, [one for one in self.effects if _goes_on(context, added, one)])
            if not parts:
                return
            with clock.time("attribution"):
                found = attribute(context, history.last.fitted, parts)
            with clock.time("trials"):
                further = try_effects(context, history.last, tuple(map(Candidate.of, found)), [])
                if further is None:
                    return
                added = _accept(context, history, further)
            self._keep(added)

    def _weighed(self, left: int) -> Weighed:
        """Weigh what may be tried where ``left`` effects may still be added."""
        context, history = self.search.context, self.search.history
        if not history.rounds:
            self.search.save()
        self._tell("weighing effects")
        if history.last.remains.consistent and self.adapt():
            # Beside nothing significant there are no rivals, which would have to be weighed again.
            self.known = None
        with self.search.clock.time("attribution"):
            known = self.known or weigh(context, history.last.fitted, self.effects, self.search.changes, left)
        self.known, history.ranking = None, known.ranking
        if not history.rounds:
            self.search.save()
        return known

    def adapt(self, rivals: Sequence[Candidate] = ()) -> bool:
        """Adapt the beam's prior where `adapt` wants it; whether it does. Collective: all ranks of the grid.

        No width gets less than the stated one unless the prior has been given the widths that the data want before.
        """
        context, history = self.search.context, self.search.history
        adapted = history.adapted[-1] if history.adapted else None
        has_widths = adapted is not None and adapted.after is history.last and adapted.is_of_widths
        if self.as_wide is history.last or has_widths:
            return False
        with self.search.clock.time("prior"):
            found = adapt(context, history.last, len(history.rounds), self.is_wider, self.effects, rivals)
        if found is not None:
            return self._go_on_from(found)
        if not rivals:
            self.as_wide = history.last
        return False

    @property
    def is_wider(self) -> bool:
        """Whether no width of the beam's prior may get less than the stated one."""
        return all(one.wider for one in self.search.history.adapted)

    def _go_on_from(self, adapted: Adapted) -> bool:
        """Go on with another prior of the beam."""
        history = self.search.history
        history.adapt(adapted)
        self.effects = next_of(self.search.context, self.effects, history.last.fitted.values)
        return True


def _goes_on(context: FitContext, added: Round, effect: Effect) -> bool:
    """Whether an effect may be more of what has been added: any fault of the beam after one, or the next part."""
    finding = added.candidate.finding
    if added.candidate.is_about_the_beam:
        return effect.is_about_the_beam
    if finding is None or not effect.comes_in_parts or (effect.kind, effect.law) != (finding.kind, finding.effect.law):
        return False
    return not finding.effect.larger(context.setup)


def _accept(context: FitContext, history: History, added: Round) -> Round:
    """Add a round once all that was found before is weighed again; return it. Collective: all ranks of the grid."""
    given = history.first.fitted.values
    added, places = revise(context, added, len(given.active))
    added, told = beside_noise(context, added, len(given.reweighted))
    history.add(added, places)
    history.tell_again(told)
    return added


def _take_back(context: FitContext, history: History, effects: Sequence[Effect]) -> None:
    """Take back what is faint beside the others, unphysical, not the same in all parts or explained since.

    What stays gets the priors that it wants without that. This goes on until nothing changes. Of the ``effects`` that
    are looked for the faults of the beam's model are rivals once more, where not all is explained or something is gone.

    Collective: all ranks of the grid.
    """
    given, before, unchanged_by = history.first.fitted.values, None, dict[Step, Fitted]()
    n_given, there = len(given.active), [one.place is not None for one in history.rounds]

    def given_up() -> list[bool]:
        return [one.given_up or (was and one.revoked) for was, one in zip(there, history.rounds, strict=True)]

    def rivalled(context: FitContext, last: Round, n_given: int) -> Taken:
        faults = [one for one in effects if one.is_control_model or one.is_about_the_beam]
        is_asked = any(given_up()) or not last.after.remains.consistent
        return take_back_rivalled(context, last, n_given, faults if is_asked else [])

    while history.rounds and history.last is not before:
        before = history.last
        for step in (take_back_faint, take_back_unphysical, take_back, rivalled, _revised):
            fitted = history.last.fitted
            if len(fitted.values.active) > n_given and unchanged_by.get(step) is not fitted:
                last, places, asked = step(context, history.rounds[-1], n_given)
                # What these refuse explains the data, but is not what its name says.
                may_predict = step in (take_back, rivalled)
                told = [_asked(one, fitted, places, asked, may_predict) for one in (*history.rounds[:-1], last)]
                history.rounds = told[:-1]
                history.add(told[-1], places)
                if history.last.fitted is fitted:
                    unchanged_by[step] = fitted
        last, gone = take_back_weights(context, history.rounds[-1], len(given.reweighted))
        if gone:
            history.rounds = [
                replace(one, given_up=one.given_up or one.candidate.kind in gone)
                for one in (*history.rounds[:-1], last)
            ]
            history.last = last.after
    history.rounds = [replace(one, given_up=gone) for gone, one in zip(given_up(), history.rounds, strict=True)]


def _revised(context: FitContext, last: Round, n_given: int) -> Taken:
    """Weigh all effects again, beside others or another prior of the beam than when they were found; see `take_back`.

    Collective: all ranks of the grid.
    """
    last, places = revise(context, last, n_given, is_new=False)
    return last, places, {}


def _asked(
    one: Round,
    before: Fitted,
    places: Mapping[int, int | None],
    asked: Mapping[int, tuple[Constancy, ...]],
    may_predict: bool = False,
) -> Round:
    """Return a round with what is known of its effect since all were asked, as they were ``before``.

    Of one that was taken back it is told whether it ``may_predict``.
    """
    if one.place is None:
        return one
    stays = places[one.place] is not None
    taken_back = None if stays else (before.values.active[one.place], before.fit.std[one.place])
    constancy = asked.get(one.place, one.constancy)
    return replace(one, taken_back=taken_back, may_predict=may_predict and not stays, constancy=constancy)


def _heldout(checked: Checked) -> str:
    """Tell in a line how well held-out data are predicted, beside the model beam, zero and the noise."""
    now = checked.numbers.of_all
    return (
        f"held-out chi^2 {checked.score.chi2:.4g} (over the noise alone {now['noise_only_chi2']:.4g}), ln density "
        f"{now['log_density']:.6g}, rms {now['rms']:.4g} Jy ({now['explained']:.4%} explained; model beam "
        f"{now['rms_model']:.4g}, with its best scale {now['rms_model_scaled']:.4g}, zero {now['rms_zero']:.4g}, noise "
        f"{now['rms_noise']:.4g} Jy)"
    )
