"""The rules of a round: what may be tried, in which order, and which is the better."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hydrabeam_mpi.config.effects import Loop as LoopSettings
from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.fit.gauss_newton import Underway
from hydrabeam_mpi.fit.state import Active, Fitted
from hydrabeam_mpi.loop.attribution.constancy import Constancy
from hydrabeam_mpi.loop.attribution.score_effects import Finding
from hydrabeam_mpi.loop.attribution.score_noise import WeightsFound
from hydrabeam_mpi.loop.residuals.remains import Remains
from hydrabeam_mpi.loop.rules import RULES
from hydrabeam_mpi.loop.selection.heldout_numbers import HeldoutNumbers
from hydrabeam_mpi.loop.selection.heldout_score import HeldoutScore, gain_of, gain_significance


@dataclass(frozen=True)
class Checked:
    """A fit and its held-out data.

    Attributes
    ----------
    fitted : Fitted
    score : HeldoutScore
    remains : Remains
    numbers : HeldoutNumbers
    at_noise : bool
        Whether the residual is as small as noise and model allow, by the probability that all else is held to; see
        `HeldoutNumbers.excess_sigma`. Not asked where what remains is more than noise anyway.
    """

    fitted: Fitted
    score: HeldoutScore
    remains: Remains
    numbers: HeldoutNumbers
    at_noise: bool


@dataclass(frozen=True)
class Candidate:
    """Something to try: an effect or a change of weights.

    The fit of an effect begins where the linear model says that it is, or at a fit with it that has ``begun``.
    """

    kind: str
    title: str
    log_bayes_factor: float
    finding: Finding | None = None
    weights: WeightsFound | None = None
    begun: Fitted | None = None

    @classmethod
    def of(cls, finding: Finding) -> Candidate:
        """Return an effect with the evidence that has been found for it."""
        return cls(finding.kind, finding.effect.title, finding.evidence.log_bayes_factor, finding)

    @property
    def law(self) -> str | None:
        """How its parameters go on in time; None for a change of the weights."""
        return self.finding.effect.law if self.finding is not None else None

    @property
    def name(self) -> tuple[str, str | None]:
        """What tells it from others: two effects, or two laws of one, are two candidates."""
        return self.kind, self.law

    @property
    def special_case(self) -> tuple[str, str | None] | None:
        """The name of what it is where nothing changes in time; see `Cause.special_case`."""
        return self.finding.effect.special_case if self.finding is not None else None

    @property
    def is_of_bad_rows(self) -> bool:
        """Whether it leaves out whole integrations or baselines that stand out, held-out ones too."""
        return self.weights is not None and self.weights.change.weighs_heldout

    @property
    def is_of_unknown(self) -> bool:
        """Whether it leaves out rows of which nobody knows what is in them."""
        return self.weights is not None and self.weights.change.is_of_unknown

    @property
    def of_fitted(self) -> float:
        """Its log Bayes factor of the fitted rows, which is what those of effects are of."""
        of_fitted = self.weights.fit.of_fitted if self.weights is not None else None
        return self.log_bayes_factor if of_fitted is None else of_fitted

    @property
    def is_about_the_beam(self) -> bool:
        """Whether it is a fault of the beam's model itself."""
        return self.finding is not None and self.finding.effect.is_about_the_beam

    @property
    def is_control(self) -> bool:
        """Whether it is a control model: compared with the effects, but never claimed."""
        return self.finding is not None and self.finding.effect.is_control_model


@dataclass(frozen=True)
class Elsewhere:
    """Where a part of an effect, such as a source, may be as well.

    Attributes
    ----------
    log_likelihood_ratio : float
        ln(likelihood x prior) there less that of the model, in units of what is left of the data.
    parameters : tuple of dict
        Names, units, values and standard deviations there.
    """

    log_likelihood_ratio: float
    parameters: tuple[dict[str, Any], ...]


@dataclass(frozen=True)
class Round:
    """An effect that was added, and what it changed.

    Attributes
    ----------
    candidate : Candidate
    ranking : tuple of Candidate
    before, after : Checked
    sigma : float
        Significance with which held-out data got better.
    beam_change : float
    place : int or None
        Among the active effects of the last fit; None for a change of the weights, and where it was taken back since.
    revised : tuple of str
        What became of earlier effects, and of this one, when all were weighed again.
    given_up : bool
        Whether its effect was taken back when nothing more was found, and is not offered again since. It may be in the
        model nevertheless, see `selection.for_prediction`.
    taken_back : (Active, ndarray), optional
        The effect as it was when it was taken back at the end, and its standard deviations, (Nfreqs, n_params).
    may_predict : bool
        Whether it was taken back though the data want it, as it is not what its name says.
    constancy : tuple of Constancy
        Whether the effect is the same in all parts of the data, asked at the end; empty for a change of the weights.
    together : tuple of Candidate
        The effects that together explained what there was before it, with the evidence of each beside the others.
    elsewhere : tuple of Elsewhere
        Where parts of its effect may be as well, the likeliest first.
    """

    candidate: Candidate
    ranking: tuple[Candidate, ...]
    before: Checked
    after: Checked
    sigma: float
    beam_change: float
    place: int | None = None
    revised: tuple[str, ...] = ()
    given_up: bool = False
    taken_back: tuple[Active, FloatArray] | None = None
    may_predict: bool = False
    constancy: tuple[Constancy, ...] = ()
    together: tuple[Candidate, ...] = ()
    elsewhere: tuple[Elsewhere, ...] = ()

    @property
    def revoked(self) -> bool:
        """Whether its effect, or change of the weights, was taken back since: it is not claimed."""
        return self.given_up or (self.candidate.finding is not None and self.place is None)

    @property
    def evidence_of_rest(self) -> float:
        """What the others of the set add to its log Bayes factor, where it is the first; its ranking has none of them.

        As they were fitted, each with those before it, or as expected of what was not.
        """
        if not self.together or self.together[0].name != self.candidate.name:
            return 0.0
        return sum(one.log_bayes_factor for one in self.together[1:])

    @property
    def evidence_of_all(self) -> float:
        """Its log Bayes factor of all data; see `evidence_of_all`."""
        return evidence_of_all(self.candidate, self.before, self.after)

    @property
    def predicts(self) -> bool:
        """Whether its effect is in the model though it is not claimed, for prediction."""
        return self.given_up and self.place is not None


def evidence_of_all(fitted: Candidate, before: Checked, after: Checked) -> float:
    """Return the log Bayes factor of all data: of the fitted ones, and the predictive density of the held-out ones."""
    if fitted.is_of_bad_rows:
        return fitted.log_bayes_factor
    return fitted.log_bayes_factor + after.score.log_density - before.score.log_density


def in_order(wanted: Sequence[Candidate], most: int, first: Candidate | None = None) -> list[Candidate]:
    """Order candidates for trial: by evidence, but a change of the weights after all effects that come near it.

    Bad integrations are first where they have the most: what an effect explains it explains better than they do. Bad
    baselines explain nothing, and are asked after effects, whose fits may gain more than the linear model says.

    The ``first`` of those that explain the residual together is the first of the effects.

    A residual with structure is not noise, but a higher noise level seems to explain any residual. Linear effects that
    come near the first go before others: their fits are short, and long ones of no use are then broken off. What stays
    as it is goes before what changes in time where it comes near that, such as a source before one that moves. At most
    ``most`` effects are returned.
    """
    top = max((one.of_fitted for one in wanted), default=0.0)
    effects = [one for one in wanted if one.finding is not None]
    best = max((one.log_bayes_factor for one in effects), default=0.0)

    def place(one: Candidate) -> int:
        if one is first:
            return -1
        if one.is_of_bad_rows and not one.is_of_unknown and one.of_fitted >= top:
            return -2
        if one.finding is None:
            return 2
        if one.log_bayes_factor < RULES.near * top:
            return 3
        return 0 if one.finding.effect.linear and one.log_bayes_factor >= RULES.near_if_linear * best else 1

    tried = {id(one) for one in sorted(effects, key=lambda one: one is not first)[:most]}
    in_turn = sorted(wanted, key=lambda one: (place(one), -one.of_fitted))
    return _special_cases_first([one for one in in_turn if one.finding is None or id(one) in tried])


def _special_cases_first(in_turn: Sequence[Candidate]) -> list[Candidate]:
    """Put what is a special case of another, and comes near it as linear effects do, just before that."""
    ordered: dict[int, Candidate] = {}
    for one in in_turn:
        least = RULES.near_if_linear * one.log_bayes_factor
        case = [other for other in in_turn if other.name == one.special_case and other.log_bayes_factor >= least]
        ordered |= {id(each): each for each in (*case, one)}
    return list(ordered.values())


def is_better(fitted: Candidate, after: Checked, best: Round) -> bool:
    """Whether a fitted effect is better than the best so far; see `evidence_of_all`."""
    return evidence_of_all(fitted, best.before, after) > best.evidence_of_all


def may_be_better(candidate: Candidate, best: Round, enough: bool) -> bool:
    """Whether an effect with less evidence than the best one fitted so far may have more once it is fitted.

    Most effects are only roughly linear, so that what comes near is fitted too. Where the best one leaves nothing
    (``enough``) another can explain no more, and with no more evidence it can only be simpler, as may be what needs
    several elements until places or delays are refined: if one of them may cost less than the best effect does.
    A structure that was found is no noise, but few integrations or baselines with something else in them may have
    looked like one; and these leave nothing of any effect that shows in few, so that it is fitted beside them.
    """
    if candidate.finding is None:
        return candidate.is_of_bad_rows and candidate.log_bayes_factor > best.evidence_of_all
    reached = best.candidate.of_fitted
    if not is_near(candidate, reached):
        return False
    if not enough or best.candidate.is_of_bad_rows or complexity(candidate) < complexity(best.candidate):
        return True
    if candidate.log_bayes_factor > reached:
        return True
    own, others = candidate.finding, best.candidate.finding
    if not (own.effect.gets_simpler_when_fitted and candidate.log_bayes_factor > RULES.near_if_linear * reached):
        return False
    return others is None or own.evidence.least_price < others.evidence.price


def is_near(candidate: Candidate, log_bayes_factor: float) -> bool:
    """Whether an effect may have that much evidence once it is fitted; see `Rules.near`."""
    assert candidate.finding is not None
    near = RULES.near_if_linear if candidate.finding.effect.linear else RULES.near
    return candidate.log_bayes_factor >= near * log_bayes_factor


def may_still_come_to(least: float, candidate: Candidate, at: Underway, start: float, nonlinear: bool) -> bool:
    """Whether a fit may end with a ln Bayes factor above ``least``.

    The next step may raise ln(likelihood x prior), which was ``start`` without the effect, by some times what the
    linear model expects of it, as in `may_be_better`. Where no parameters are ``nonlinear``, of which the linear model
    knows nothing before the effect has a size, it is also told by how what that model expects of the end has risen on
    the way so far: on the rest of it, the root of what is left to gain, by no more in proportion. From either goes what
    the freedom of the parameters costs: unless the fit says, what it does at least.
    """
    assert candidate.finding is not None
    near = RULES.near_if_linear if candidate.finding.effect.linear else RULES.near
    risen, first, now = at.reached - start, *(one - start for one in at.foreseen)
    most = risen + at.expected / near
    if not nonlinear and risen > 0 and first != now:
        rest = np.sqrt(max(now - risen, 0.0) / max(now, risen))
        most = min(most, now + max(now - first, 0.0) * rest / (1 - rest) if rest < 1 else np.inf)
    return most - (candidate.finding.evidence.least_price if at.price is None else at.price) > least


def complexity(candidate: Candidate) -> float:
    """Return how many parameters of an effect the data tell; none of a change of the weights."""
    return candidate.finding.evidence.effective_parameters if candidate.finding else 0.0


def improvement(before: Checked, after: Checked, candidate: Candidate) -> float:
    """Return the significance with which held-out data got better; it is reported, and decides nothing."""
    if candidate.finding is None:
        return float(abs(before.score.chi2 - after.score.chi2) * np.sqrt(before.score.n_data))
    one, two = before.score, after.score
    return gain_significance(one, two, gain_of(one, two))


def indistinguishable(
    candidate: Candidate,
    ranking: Sequence[Candidate],
    settings: LoopSettings,
    of_rest: float = 0.0,
    of_heldout: float = 0.0,
) -> list[Candidate]:
    """Return what explains the residual as well as the candidate: by less than the evidence asked for.

    ``of_rest`` is the evidence of what explains, beside the candidate, what those in the ranking have to explain too,
    and ``of_heldout`` that of the held-out data for the candidate, which bad integrations and baselines have in theirs.
    """
    near = candidate.log_bayes_factor + of_rest - settings.min_log_bayes_factor

    def is_near(one: Candidate) -> bool:
        return one.log_bayes_factor > near + (of_heldout if one.is_of_bad_rows else 0.0)

    return [one for one in ranking if one.name != candidate.name and is_near(one)]
