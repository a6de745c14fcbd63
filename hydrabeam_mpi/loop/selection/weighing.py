"""What may be tried: everything that may explain the residual, each by itself and all together."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace

from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.interface.reweighting import Reweighting
from hydrabeam_mpi.effects.shared.time_laws import Piecewise
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.error_scale import left_of
from hydrabeam_mpi.fit.state import Fitted, Values
from hydrabeam_mpi.loop.attribution.candidate_rows import CachedRowBlocks
from hydrabeam_mpi.loop.attribution.evidence import Evidence
from hydrabeam_mpi.loop.attribution.score_effects import Finding, attribute
from hydrabeam_mpi.loop.attribution.score_noise import fit_reweightings, looked_for_again
from hydrabeam_mpi.loop.attribution.weigh_together import TogetherFound, weigh_together
from hydrabeam_mpi.loop.selection.acceptance import Candidate, Checked, Round, complexity, is_near
from hydrabeam_mpi.mpi import bcast_object, together

ABRUPT = (Piecewise.name,)
"""Laws in time that stand for what is constant as well: what jumps near the first time is nearly that."""


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
    log_bayes_factor : float
        Of all of them together.
    """

    members: tuple[Candidate, ...] = ()
    beside: tuple[tuple[Candidate, ...], ...] = ()
    log_bayes_factor: float = 0.0

    @classmethod
    def of(cls, found: TogetherFound, most: int) -> Together:
        """Return what was found, ``most`` members at most."""
        beside = [list(map(Candidate.of, one)) for one in found.beside[:most]]
        ordered = tuple(tuple(sorted(one, key=_best_first)) for one in beside)
        return cls(tuple(one[0] for one in beside), ordered, found.log_bayes_factor)

    @property
    def evidences(self) -> list[Evidence]:
        """What the data say of those that are effects."""
        return [one.finding.evidence for one in self.members if one.finding]

    @property
    def n_parameters(self) -> float:
        """How many parameters they have, as far as these are told."""
        return sum(one.effective_parameters for one in self.evidences)

    def without(self, names: Collection[tuple[str, str | None]]) -> Together:
        """Return those that have none of the names (kind and law)."""
        left = [i for i, one in enumerate(self.members) if one.name not in names]
        members, beside = tuple(self.members[i] for i in left), tuple(self.beside[i] for i in left)
        return replace(self, members=members, beside=beside)

    def in_place_of(self, member: Candidate) -> tuple[Candidate, ...]:
        """Return what could stand in the place of a member, beside the others, itself among it."""
        return self.beside[next(i for i, one in enumerate(self.members) if one.name == member.name)]


@dataclass(frozen=True)
class Weighed:
    """What may be tried.

    Attributes
    ----------
    ranking : tuple of Candidate
        Everything, by its evidence of the fitted rows.
    first : Candidate or None
        Of the ranking: the one that has the most evidence beside the others of the set.
    together : Together
        Set that explains the residual; of none where there is no such.
    explains : bool
        Whether the set leaves no more than noise.
    simpler : tuple of Together
        Sets with less evidence and fewer parameters: in an exact fit they may have more.
    with_drift : Together
        A constant effect and how it changes in time, where both have more evidence together than anything by itself
        and no set explains the residual; else of none.
    """

    ranking: tuple[Candidate, ...]
    first: Candidate | None = None
    together: Together = field(default_factory=Together)
    explains: bool = False
    simpler: tuple[Together, ...] = ()
    with_drift: Together = field(default_factory=Together)

    @property
    def most_of_effects(self) -> float:
        """The log Bayes factor of the set, or of the effect that has the most by itself where that is more."""
        return max(self.together.log_bayes_factor, self.most_by_itself)

    @property
    def most_by_itself(self) -> float:
        """The log Bayes factor of the effect that has the most by itself."""
        effects = (one for one in self.ranking if one.finding is not None and not one.is_control)
        return max((one.log_bayes_factor for one in effects), default=0.0)


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
        After the first that was confirmed, if that was looked at; or after what leads further than that.
    leads : bool
        Whether that leads further than all that explain more by themselves; see `leads_further`.
    """

    context: FitContext
    effects: Sequence[Effect]
    changes: Sequence[Reweighting]
    most: int
    weighed: Weighed
    ahead: tuple[Fitted, Weighed] | None = None
    leads: bool = False

    def explains_rest(self, best: Round) -> bool:
        """Whether further effects explain what the best leaves, or enough of it. Collective: all ranks of the grid."""
        return self.leads or self._beside(best).explains

    def with_rest(self, best: Round) -> Round | None:
        """Return the best and what explains what it leaves as one round; None where nothing does.

        Of all these it is known what they come to, as far as the model is linear. Collective: all ranks of the grid.
        """
        weighed, finding = self._beside(best), best.candidate.finding
        if not (weighed.explains or self.leads):
            return None
        total = best.candidate.log_bayes_factor + weighed.most_of_effects
        if finding is not None:
            finding = replace(finding, evidence=finding.evidence.with_others(weighed.together.evidences))
        return replace(best, candidate=replace(best.candidate, log_bayes_factor=total, finding=finding))

    def leads_further(self, candidate: Candidate, after: Checked, best: Round) -> Weighed | None:
        """Return what there is to try beside a simpler effect if it leads further than the best; None if not.

        It does if it has more evidence, with what explains most beside it, than the best can come to: no effects gain
        more beside that than what it leaves above the noise. Alone it may explain less than what has many more
        parameters, which take up a part of all that is missing. Collective: all ranks of the grid.
        """
        needed = best.candidate.of_fitted + left_of(self.context, best.after.fitted).above_noise - candidate.of_fitted
        if not self._may_lead(candidate, after.fitted, best.candidate, needed):
            return None
        weighed = self._weigh_beside(after.fitted, 1)
        return weighed if weighed.most_of_effects > needed else None

    def is_led_by(self, best: Round, candidate: Candidate, after: Checked) -> bool:
        """Whether a simpler best one leads further than what has more evidence by itself; see `leads_further`.

        Each is taken with what explains most beside it. Collective: all ranks of the grid.
        """
        needed = candidate.of_fitted - best.candidate.of_fitted
        if not self._may_lead(best.candidate, best.after.fitted, candidate, needed):
            return False
        gained = self._ahead_of(best).most_of_effects
        if gained <= needed:
            return False
        if gained > needed + left_of(self.context, after.fitted).above_noise:
            return True
        beside = self._weigh_beside(after.fitted, 1)
        if gained > needed + beside.most_of_effects:
            return True
        self.ahead = after.fitted, beside
        return False

    def _may_lead(self, one: Candidate, with_one: Fitted, two: Candidate, needed: float) -> bool:
        """Whether one is simpler than another, and leaves more than the nats that are ``needed`` beside it."""
        if one.finding is None or complexity(one) >= complexity(two) or not is_near(one, two.of_fitted):
            return False
        return left_of(self.context, with_one).above_noise > needed

    def follow(self, best: Round, beside: Weighed) -> None:
        """Go on with the best, which leads further than all others, and with what there is to try beside it."""
        self.ahead, self.leads = (best.after.fitted, beside), True

    def beside(self, best: Round, candidate: Candidate) -> float:
        """Return the log Bayes factor that a candidate has beside the best; none where it has less than is asked for.

        Collective: all ranks of the grid.
        """
        least = self.context.problem.job.loop.min_log_bayes_factor
        found = (one.log_bayes_factor for one in self._ahead_of(best).ranking if one.name == candidate.name)
        return max((one for one in found if one >= least), default=0.0)

    def _ahead_of(self, best: Round) -> Weighed:
        """Weigh all with the best in the model, if it is not the one of which that is known."""
        fitted = best.after.fitted
        if self.ahead is None or self.ahead[0] is not fitted:
            self.ahead = fitted, self._weigh_beside(fitted, max(len(best.together), 1))
        return self.ahead[1]

    def _beside(self, best: Round) -> Weighed:
        """Return what there is to try beside the best, or of nothing if another one was that when it was looked at.

        To know it all are weighed with the best in the model, as they are in the next round; once in a round.
        """
        is_other = self.ahead is not None and self.ahead[0] is not best.after.fitted
        return Weighed(()) if is_other else self._ahead_of(best)

    def _weigh_beside(self, fitted: Fitted, n_added: int) -> Weighed:
        effects = next_of(self.context, self.effects, fitted.values)
        return weigh(self.context, fitted, effects, self.changes, self.most - n_added)

    def after(self, fitted: Fitted) -> Weighed | None:
        """Return what there is to try with what has been fitted, if that is known."""
        return self.ahead[1] if self.ahead is not None and self.ahead[0] is fitted else None


def next_of(context: FitContext, effects: Sequence[Effect], values: Values) -> Sequence[Effect]:
    """Return the effects to look for after those of the model. Collective: all ranks of the grid.

    Which points of the sky come next may be decided by rounding, so that rank 0 says it.
    """
    for one in values.active:
        effects = [effect.next_after(context.setup, one.effect) for effect in effects]
    told: Sequence[Effect] = bcast_object(context.grid.world, effects)
    return told


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
    all effects together, these are not believed, unless it leaves out what nobody knows. Where these leave no more than
    noise, what was refused is not looked for in a robust fit, which takes longer than all else.
    """
    with together(context.grid.world):
        cached = CachedRowBlocks.of(context, fitted.estimate)
    findings = attribute(context, fitted, effects, cached)
    candidates = list(map(Candidate.of, findings))
    done = {one.change.kind for one in fitted.values.reweighted}
    weights = fit_reweightings(context, fitted, [one for one in changes if one.kind not in done])
    least, found = context.problem.job.loop.min_log_bayes_factor, None
    if most > 0 and sum(one.log_bayes_factor >= least for one in candidates) > 1:
        found = weigh_together(context, fitted, findings, cached)
    if found is None or not found.explains:
        weights = looked_for_again(context, fitted, weights)
    reweightings = [
        Candidate(one.change.kind, one.change.title, one.fit.log_bayes_factor, weights=one) for one in weights
    ]
    ranking = tuple(sorted((*candidates, *reweightings), key=_best_first))
    by_weights = max((one.of_fitted for one in reweightings if not one.is_of_unknown), default=0.0)
    if found is None or not found.numbers or by_weights > found.log_bayes_factor:
        return Weighed(ranking)
    simpler = tuple(Together.of(one, most) for one in found.simpler)
    with_drift = Together() if found.explains or most < 2 else _with_drift(context, fitted, findings, cached)
    return Weighed(ranking, candidates[found.numbers[0]], Together.of(found, most), found.explains, simpler, with_drift)


def _with_drift(context: FitContext, fitted: Fitted, findings: Sequence[Finding], cached: CachedRowBlocks) -> Together:
    """Weigh the constant effect and its change in time that may have the most evidence together.

    By itself either leaves what the other explains, so that what jumps, or jitters, has more, which stands for both. No
    more than their sum is expected: a pass over the rows is made for each kind of which that may be enough.
    Collective: all ranks of the grid.
    """
    most, best = findings[0].evidence.log_bayes_factor, Together()
    gradual = [one for one in findings if one.effect.law not in ABRUPT]
    constant = [one for one in gradual if one.effect.law == Effect.law]
    families = [[one, *(law for law in gradual if law.kind == one.kind and law is not one)] for one in constant]
    for family in sorted(families, key=_of_constant_and_best_law, reverse=True):
        if _of_constant_and_best_law(family) <= most:
            break
        found = weigh_together(context, fitted, family, cached)
        if found.log_bayes_factor > most:
            most, best = found.log_bayes_factor, Together.of(found, len(family))
    return best


def _of_constant_and_best_law(findings: Sequence[Finding]) -> float:
    return sum(one.evidence.log_bayes_factor for one in findings[:2])


def _best_first(one: Candidate) -> float:
    return -one.of_fitted
