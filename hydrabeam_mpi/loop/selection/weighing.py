"""What may be tried: everything that may explain the residual, each by itself and all together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.interface.reweighting import Reweighting
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.error_scale import fitted_chi2
from hydrabeam_mpi.fit.state import Fitted, Values
from hydrabeam_mpi.loop.attribution.candidate_rows import CachedRowBlocks
from hydrabeam_mpi.loop.attribution.score_effects import attribute
from hydrabeam_mpi.loop.attribution.score_noise import fit_reweightings
from hydrabeam_mpi.loop.attribution.weigh_together import weigh_together
from hydrabeam_mpi.loop.selection.acceptance import Candidate, Checked, Round, is_better
from hydrabeam_mpi.mpi import together


@dataclass(frozen=True)
class Together:
    """Effects that together explain what is left, as far as the model is linear: those that are still to be tried.

    Attributes
    ----------
    members : tuple of Candidate
        By the evidence that each has beside the others, best first.
    beside : tuple of tuple of Candidate
        For each of them, what could stand in its place beside the others, itself with that evidence among it, ordered
        by evidence.
    """

    members: tuple[Candidate, ...] = ()
    beside: tuple[tuple[Candidate, ...], ...] = ()


@dataclass(frozen=True)
class Weighed:
    """What may be tried.

    Attributes
    ----------
    ranking : tuple of Candidate
        Everything, by its evidence.
    first : Candidate or None
        Of the ranking: the one that has the most evidence beside the others of the set.
    together : Together
        Set that explains the residual; of none where there is no such.
    explains : bool
        Whether the set leaves no more than noise.
    """

    ranking: tuple[Candidate, ...]
    first: Candidate | None = None
    together: Together = field(default_factory=Together)
    explains: bool = False

    @classmethod
    def next_of(cls, rest: Together) -> Weighed:
        """Return what to try once others of a set are part of the model."""
        return cls(rest.beside[0], rest.members[0], rest)

    def after(self, added: Candidate) -> Together | None:
        """Return what is left of the set once its first has been added, as it was fitted; None where nothing is.

        What is worth no more than the linear model was wrong by is weighed again.
        """
        if self.first is None or added.name != self.first.name:
            return None
        wrong_by = abs(added.log_bayes_factor - self.first.log_bayes_factor)
        n = sum(one.log_bayes_factor > wrong_by for one in self.together.members[1:])
        return Together(self.together.members[1 : 1 + n], self.together.beside[1 : 1 + n]) if n else None

    def is_of_use(self, added: Candidate) -> bool:
        """Whether a fit came to about what was expected when an effect was chosen without weighing all again.

        Where it came to something else by more than that, the linear model had said nothing of it, nor of others.
        """
        expected = next(one for one in self.ranking if one.name == added.name)
        return abs(added.log_bayes_factor - expected.log_bayes_factor) <= expected.log_bayes_factor


@dataclass
class Outlook:
    """What may be tried now, and what there will be to try once the best so far has been added.

    Attributes
    ----------
    context : FitContext
    effects, changes
        To look for.
    most : int
        Effects that may still be added.
    weighed : Weighed
    ahead : (Fitted, Weighed), optional
        After the first that was confirmed, if that was looked at.
    """

    context: FitContext
    effects: Sequence[Effect]
    changes: Sequence[Reweighting]
    most: int
    weighed: Weighed
    ahead: tuple[Fitted, Weighed] | None = None

    def explains_rest(self, best: Round) -> bool:
        """Whether further effects explain what the best leaves. Collective: all ranks of the grid.

        To know that all are weighed with it in the model, as they are in the next round; once in a round.
        """
        fitted = best.after.fitted
        if self.weighed.after(best.candidate) is not None:
            return True
        if self.ahead is None:
            effects = next_of(self.context, self.effects, fitted.values)
            self.ahead = fitted, weigh(self.context, fitted, effects, self.changes, self.most - 1)
        at, weighed = self.ahead
        return at is fitted and weighed.explains

    def is_better(self, fitted: Candidate, after: Checked, best: Round) -> bool:
        """Whether a fitted effect is better than the best so far; see `acceptance.is_better`.

        Where the best is the first of a set that leaves no more than noise, another has to come to more than the whole
        set, with all that further effects could explain of what it leaves. Positions of all antennas may stand for a
        clock that is wrong together with the gain of one of them. Collective: all ranks of the grid.
        """
        rest = self.weighed.after(best.candidate)
        if rest is not None and self.weighed.explains:
            left, noise = fitted_chi2(self.context, after.fitted)
            of_set = best.candidate.log_bayes_factor + sum(one.log_bayes_factor for one in rest.members)
            if fitted.log_bayes_factor + max(left - noise, 0.0) < of_set:
                return False
        return is_better(fitted, after, best)

    def comes_next(self, candidate: Candidate, best: Round) -> bool:
        """Whether a candidate explains, beside the best, what this leaves: it is no rival of it, but tried after it."""
        rest = self.weighed.after(best.candidate)
        return rest is not None and candidate.name in {one.name for one in rest.members}

    def after(self, fitted: Fitted) -> Weighed | None:
        """Return what there is to try with what has been fitted, if that is known."""
        return self.ahead[1] if self.ahead is not None and self.ahead[0] is fitted else None


def next_of(context: FitContext, effects: Sequence[Effect], values: Values) -> Sequence[Effect]:
    """Return the effects to look for after those of the model."""
    for one in values.active:
        effects = [effect.next_after(context.setup, one.effect) for effect in effects]
    return effects


def rank(
    context: FitContext, fitted: Fitted, effects: Sequence[Effect], changes: Sequence[Reweighting]
) -> tuple[Candidate, ...]:
    """Order everything that may be tried by its evidence. Collective: all ranks of the grid."""
    return weigh(context, fitted, effects, changes, 0).ranking


def weigh(
    context: FitContext, fitted: Fitted, effects: Sequence[Effect], changes: Sequence[Reweighting], most: int
) -> Weighed:
    """Weigh each effect by itself, and all together for a set of ``most`` of them.

    Collective: all ranks of the grid. A change of the weights explains any residual: where it has more evidence than
    all effects together, these are not believed.
    """
    with together(context.grid.world):
        cached = CachedRowBlocks.of(context, fitted.estimate)
    findings = attribute(context, fitted, effects, cached)
    candidates = list(map(Candidate.of, findings))
    done = {one.change.kind for one in fitted.values.reweighted}
    reweightings = [
        Candidate(found.change.kind, found.change.title, found.fit.log_bayes_factor, weights=found)
        for found in fit_reweightings(context, fitted, [one for one in changes if one.kind not in done])
    ]
    ranking = tuple(sorted((*candidates, *reweightings), key=_best_first))
    least = context.problem.job.loop.min_log_bayes_factor
    if most < 1 or sum(one.log_bayes_factor >= least for one in candidates) < 2:
        return Weighed(ranking)
    found = weigh_together(context, fitted, findings, cached)
    by_weights = max((one.log_bayes_factor for one in reweightings), default=0.0)
    if not found.numbers or by_weights > found.log_bayes_factor:
        return Weighed(ranking)
    beside = [list(map(Candidate.of, one)) for one in found.beside[:most]]
    members = tuple(one[0] for one in beside)
    chosen = Together(members, tuple(tuple(sorted(one, key=_best_first)) for one in beside))
    return Weighed(ranking, candidates[found.numbers[0]], chosen, found.explains)


def _best_first(one: Candidate) -> float:
    return -one.log_bayes_factor
