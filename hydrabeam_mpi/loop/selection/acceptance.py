"""The rules of a round: which effects are tried, in which order, and when one is accepted or refused."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hydrabeam_mpi.config.effects import Loop as LoopSettings
from hydrabeam_mpi.fit.state import Fitted
from hydrabeam_mpi.loop.attribution.score_effects import Finding
from hydrabeam_mpi.loop.attribution.score_noise import WeightsFound
from hydrabeam_mpi.loop.residuals.remains import Remains
from hydrabeam_mpi.loop.selection.heldout_numbers import HeldoutNumbers
from hydrabeam_mpi.loop.selection.heldout_score import HeldoutScore, gain_significance

MAX_ABSORBED = 0.95
"""Where the beam can absorb more than this fraction of an effect's signature, it is claimed only if nothing else is
left.
"""
HOPELESS = 0.99
"""Such a fraction above which it is not even fitted."""
NEARLY_ABSORBED = 0.9
"""Above this, check absorption again after the fit.

A strong effect that changes the sky is then part of what the beam sees, so that the two always have much in common.
"""
TOO_SMALL = 0.7
"""Held-out reduced chi^2 below which predictions claim far less than they should."""
NEAR = 0.1
"""Effects with less than this fraction of the best one's evidence are not fitted."""
NEAR_IF_LINEAR = 0.7
"""The same for effects that are nearly linear, whose evidence a fit hardly changes."""
UNDECIDED_NATS = 5.0
"""Effects whose ln evidence differs by less than this from the best one's cannot be told from it."""


@dataclass(frozen=True)
class Checked:
    """A fit and its held-out data."""

    fitted: Fitted
    score: HeldoutScore
    remains: Remains
    numbers: HeldoutNumbers


@dataclass(frozen=True)
class Candidate:
    """Something to try: an effect or a change of weights."""

    kind: str
    title: str
    log_bayes_factor: float
    finding: Finding | None = None
    weights: WeightsFound | None = None

    @property
    def is_control(self) -> bool:
        """Whether it is a control model: compared with the effects, but never claimed."""
        return self.finding is not None and self.finding.effect.is_control_model


@dataclass(frozen=True)
class Round:
    """An effect that was added, and what it changed."""

    candidate: Candidate
    ranking: tuple[Candidate, ...]
    before: Checked
    after: Checked
    sigma: float
    beam_change: float


def is_absorbed(candidate: Candidate, limit: float = MAX_ABSORBED) -> bool:
    """Whether another beam would explain nearly all of an effect's signature, so that data cannot tell them apart.

    Never so for faults of the beam model itself, such as a basis that is too small.
    """
    if candidate.finding is None or candidate.finding.effect.is_about_the_beam:
        return False
    return candidate.finding.evidence.absorbed > limit


def is_hopeless(candidate: Candidate, wanted: Sequence[Candidate]) -> bool:
    """Whether what the beam can absorb of an effect is too much for it to be fitted.

    The effect with the most evidence is fitted all the same, as it might explain everything.
    """
    best = max(one.log_bayes_factor for one in wanted)
    return is_absorbed(candidate, HOPELESS) or (is_absorbed(candidate) and candidate.log_bayes_factor < best)


def absorbed_reason(candidate: Candidate) -> str:
    """Say why an effect that the beam can absorb is not claimed."""
    assert candidate.finding is not None
    share = candidate.finding.evidence.absorbed
    return f"the beam can absorb {share:.1%} of it, so that these data cannot tell it from another beam"


def in_order(wanted: Sequence[Candidate], most: int) -> list[Candidate]:
    """Order candidates for trial: by evidence, but a change of the weights after all effects that come near it.

    A residual with structure is not noise, but a higher noise level seems to explain any residual. At most ``most``
    effects are returned.
    """
    top = max((one.log_bayes_factor for one in wanted), default=0.0)

    def place(one: Candidate) -> int:
        return 1 if one.finding is None else 0 if one.log_bayes_factor >= NEAR * top else 2

    tried = {id(one) for one in [one for one in wanted if one.finding is not None][:most]}
    return [one for one in sorted(wanted, key=place) if one.finding is None or id(one) in tried]


def is_better(fitted: Candidate, after: Checked, best: Round) -> bool:
    """Whether a fitted effect is better than the best so far.

    Compares the evidence of the fitted data plus the predictive density of the held-out ones: together the evidence of
    all data.
    """
    ahead = fitted.log_bayes_factor - best.candidate.log_bayes_factor
    return ahead + after.score.log_density - best.after.score.log_density > 0


def may_be_better(candidate: Candidate, best: Round, enough: bool) -> bool:
    """Whether an effect with less evidence than the best one fitted so far may have more once it is fitted.

    Most effects are only roughly linear, so that what comes near is fitted too. Where the best one leaves nothing
    (``enough``) another can only be simpler, as may be what needs several elements until places or delays are refined.
    A structure that was found is no noise.
    """
    if candidate.finding is None:
        return False
    near = NEAR_IF_LINEAR if candidate.finding.effect.linear else NEAR
    if candidate.log_bayes_factor < near * best.candidate.log_bayes_factor:
        return False
    if not enough or _complexity(candidate) < _complexity(best.candidate):
        return True
    simpler = candidate.finding.effect.gets_simpler_when_fitted
    return simpler and candidate.log_bayes_factor > NEAR_IF_LINEAR * best.candidate.log_bayes_factor


def _complexity(candidate: Candidate) -> float:
    return candidate.finding.evidence.effective_parameters if candidate.finding else 0.0


def improvement(before: Checked, after: Checked, candidate: Candidate) -> float:
    """Return the significance with which held-out data got better."""
    if candidate.finding is None:
        return float(abs(before.score.chi2 - after.score.chi2) * np.sqrt(before.score.n_data))
    return gain_significance(before.score, after.score, after.score.log_density - before.score.log_density)


def refusal_of(
    before: Checked, after: Checked, tried: Candidate, candidate: Candidate, sigma: float, settings: LoopSettings
) -> str | None:
    """Say why a candidate, as ``tried`` and as it has been fitted, is not kept; None where it is."""
    if not candidate.log_bayes_factor >= settings.min_log_bayes_factor:
        return f"its log Bayes factor is {candidate.log_bayes_factor:.4g} once it is fitted"
    if candidate.weights is not None:
        if abs(after.score.chi2 - 1) > abs(before.score.chi2 - 1):
            return f"held-out chi^2 goes from {before.score.chi2:.4g} to {after.score.chi2:.4g}"
        return None if after.remains.white else f"what is left is not white: {after.remains.why}"
    absorbed = is_absorbed(tried) or (is_absorbed(tried, NEARLY_ABSORBED) and is_absorbed(candidate))
    if absorbed and not after.remains.consistent:
        return absorbed_reason(candidate if is_absorbed(candidate) else tried)
    if candidate.finding is not None:
        active = after.fitted.values.active[-1]
        unphysical = active.effect.unphysical(active.x, after.fitted.fit.std[-1])
        if unphysical is not None:
            return unphysical
    if after.score.chi2 < TOO_SMALL:
        return f"it is so uncertain that it predicts nothing: held-out chi^2 {after.score.chi2:.4g}"
    change = f"{before.score.chi2:.4g} to {after.score.chi2:.4g}"
    if not after.score.chi2 < before.score.chi2:
        return f"held-out chi^2 does not fall: {change}"
    if (rises := rise_of_rms(before, after)) is not None:
        return rises
    if not after.score.log_density_at_own_level > before.score.log_density_at_own_level:
        return f"held-out chi^2 goes from {change} by predictions that get wider rather than nearer"
    if sigma < settings.min_heldout_sigma:
        return f"held-out chi^2 falls by {sigma:.1f} sigma only, {change}"
    return None


def rise_of_rms(before: Checked, after: Checked) -> str | None:
    """Say by how much the plain residual of the held-out data rises; None where it does not, beyond its error.

    The error is one standard error of the paired difference over blocks. A change of the weights claims nothing of what
    is predicted, and is not asked.
    """
    if not after.numbers.rise_sigma(before.numbers) > 1:
        return None
    one, two = before.numbers.of_all, after.numbers.of_all
    change = f"the rms of the held-out residual rises from {one['rms']:.4g} to {two['rms']:.4g} Jy"
    return f"{change}, by more than its error (noise {two['rms_noise']:.4g} Jy, the data {two['rms_zero']:.4g} Jy)"


def why_unexplained(last: Checked, control: Round | None) -> str | None:
    """Say why the last fit does not explain the data; None where it does."""
    now = last.numbers.of_all
    rms = f"the held-out residual has {now['rms']:.4g} Jy rms"
    if not last.remains.consistent:
        return (
            f"predictions are not calibrated: what is left is more than they expect (predictive chi^2 "
            f"{last.score.chi2:.4g}), and {rms} where the noise has {now['rms_noise']:.4g} Jy"
        )
    if not last.numbers.at_noise:
        return (
            f"predictions are calibrated, but only as they are wide: {rms}, where the noise has "
            f"{now['rms_noise']:.4g} Jy and, with what the data leave uncertain of the beam, "
            f"{now['rms_expected']:.4g} Jy are expected"
        )
    return None if control is None else f"{control.candidate.title} would explain more than any effect"


def indistinguishable(candidate: Candidate, ranking: Sequence[Candidate]) -> list[str]:
    """Name the effects that explain the residual as well as the candidate, within the evidence's own reach."""
    near = candidate.log_bayes_factor - UNDECIDED_NATS
    return [one.kind for one in ranking if one.kind != candidate.kind and one.log_bayes_factor > near]
