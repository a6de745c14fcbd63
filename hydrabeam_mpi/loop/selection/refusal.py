"""When a fitted effect is refused: what speaks against it, in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydrabeam_mpi.config.effects import Loop as LoopSettings
from hydrabeam_mpi.loop.attribution.constancy import Constancy
from hydrabeam_mpi.loop.rules import RULES
from hydrabeam_mpi.loop.selection.acceptance import Candidate, Checked
from hydrabeam_mpi.loop.selection.heldout_score import gain_by_chance, gain_of


def refusal_of(
    before: Checked, after: Checked, candidate: Candidate, settings: LoopSettings, least: float | None = None
) -> str | None:
    """Say why a candidate, as it has been fitted, is not kept; None where it is.

    It needs the evidence of the fitted data, the ``least`` or as much as the job asks for, and a better prediction of
    the held-out ones. Both are valid for whatever parameters a fit has come to. So one that has not converged is kept
    where it passes; where it does not, that says nothing against the effect.
    """
    asked = settings.min_log_bayes_factor
    least = asked if least is None else least
    reason: str | None
    if candidate.log_bayes_factor >= least and candidate.finding is None:
        reason = _refusal_of_weights(before, after, candidate)
    elif candidate.log_bayes_factor >= least:
        reason = refusal_by_heldout(before, after, settings)
    else:
        reason = f"its log Bayes factor is {candidate.log_bayes_factor:.4g} once it is fitted"
        if candidate.log_bayes_factor >= asked:
            reason += f", where {least:.4g} is asked beside what is left, {least / asked:.3g} times the noise"
    if reason is not None and not after.fitted.diagnostics.converged:
        return f"its fit did not converge, which says nothing for or against it (where it ended, {reason})"
    return reason


def _refusal_of_weights(before: Checked, after: Checked, candidate: Candidate) -> str | None:
    """Say why a change of the weights is not kept: what is left is white unless something else is known to be there.

    What leaves out most rows has not told a few from the others.
    """
    if 2 * after.score.n_data < before.score.n_data:
        return f"it leaves out all but {after.score.n_data} of {before.score.n_data} held-out data"
    if abs(after.score.chi2 - 1) > abs(before.score.chi2 - 1):
        return f"held-out chi^2 goes from {before.score.chi2:.4g} to {after.score.chi2:.4g}"
    if after.remains.white or (candidate.weights and candidate.weights.change.at_own_level):
        return None
    return f"what is left is not white: {after.remains.why}"


def refusal_by_heldout(before: Checked, after: Checked, settings: LoopSettings) -> str | None:
    """Say why held-out data do not want an effect in the model; None where they do."""
    if (rises := rise_of_rms(before, after)) is not None:
        return rises
    gain, chance = gain_of(before.score, after.score), gain_by_chance(before.score, after.score)
    if not gain >= settings.min_log_bayes_factor:
        change = f"{before.score.chi2:.4g} to {after.score.chi2:.4g}"
        return f"held-out data are predicted no better: ln of their density changes by {gain:.4g}, chi^2 from {change}"
    if not gain >= chance:
        return (
            f"held-out data are predicted no better than by chance: ln of their density rises by {gain:.4g}, where as "
            f"many of them get better as worse it changes by {chance:.2g}"
        )
    return None


def rivals_of(candidate: Candidate, ranking: Sequence[Candidate], settings: LoopSettings) -> list[Candidate]:
    """Return the faults of the beam's model that explain as much as a fitted effect: what it must be told from.

    They are modes that the basis lacks and beams that change in time, freedom that no data can be sure not to need. An
    effect is claimed if the best model with it is likelier than the best without: where it has more evidence than a
    rival alone, or where it has enough with the rival marginalised.
    """
    if candidate.finding is None:
        return []
    near = max(candidate.log_bayes_factor - settings.min_log_bayes_factor, 0.0)
    faults = [one for one in ranking if _is_fault_of_beam(one) and one.kind != candidate.kind]
    return [one for one in faults if one.log_bayes_factor > near]


def _is_fault_of_beam(candidate: Candidate) -> bool:
    return candidate.is_control or candidate.is_about_the_beam


def refusal_beside(rival: Candidate, left: float, settings: LoopSettings) -> str | None:
    """Say that an effect has too little evidence, ``left``, with a rival marginalised; None where it has enough."""
    if left >= settings.min_log_bayes_factor:
        return None
    return (
        f"{rival.title} explains as much (ln BF {rival.log_bayes_factor:.4g}), and beside that its log Bayes factor is "
        f"{left:.4g}"
    )


def refusal_by_parts(constancy: Sequence[Constancy], settings: LoopSettings) -> str | None:
    """Say between which parts of the data an effect differs so much that it is not what it says; None where it is.

    It needs the evidence that the job asks for that its parameters have a common part, or what is expected of an effect
    that is the same in all parts, less as much, where few parts tell them. Where even such an effect is expected to
    have none, the answer says nothing. If that is so because of what else is left, which it would have by noise alone,
    and no other division of the data tells that it is the same in all parts, it cannot be told from what is left.
    """
    least = settings.min_log_bayes_factor
    for one in constancy:
        if _margin(one, settings) < 0:
            return (
                f"it is not the same in all parts of the data: its parameters differ between {one.between} by "
                f"{one.spread:.2g} times what they have in common (ln BF that they have a common part "
                f"{one.log_bayes_factor:.3g}, where {one.expected:.3g} is expected of what is the same in all)"
            )
    if any(one.expected > 0 and one.log_bayes_factor >= least for one in constancy):
        return None
    for one in constancy:
        if one.expected <= 0 and one.expected_by_noise >= least:
            return (
                f"it cannot be told from what is left beside it: with errors as large as that makes them, ln BF "
                f"{one.expected:.3g} is expected of a common part between {one.between} even if it has one, where by "
                f"noise alone {one.expected_by_noise:.3g} were"
            )
    return None


def margin_of_parts(constancy: Sequence[Constancy], settings: LoopSettings) -> tuple[float, float]:
    """Return by how many nats an effect is the same in all parts, or is not if below zero; see `refusal_by_parts`.

    With it how many are expected where it is, which orders those that cannot be told from what is left.
    """
    margin = min((_margin(one, settings) for one in constancy), default=np.inf)
    return margin, min((one.expected for one in constancy), default=np.inf)


def _margin(one: Constancy, settings: LoopSettings) -> float:
    least = settings.min_log_bayes_factor
    return one.log_bayes_factor - min(least, one.expected - least) if one.expected > 0 else np.inf


def rise_of_rms(before: Checked, after: Checked) -> str | None:
    """Say by how much the plain residual of the held-out data rises; None where it does not, beyond its error.

    That is of the paired difference over blocks, see `Rules.decided_sigmas`. What rises above the data themselves is
    worse than to predict nothing, however few the blocks that it comes from. A change of the weights claims nothing of
    what is predicted, and is not asked.
    """
    one, two = before.numbers.of_all, after.numbers.of_all
    if two["rms"] > max(two["rms_zero"], one["rms"]):
        return (
            f"the held-out residual has {two['rms']:.4g} Jy rms, where predicting nothing leaves {two['rms_zero']:.4g}"
        )
    if not after.numbers.rise_sigma(before.numbers) > RULES.decided_sigmas:
        return None
    change = f"the rms of the held-out residual rises from {one['rms']:.4g} to {two['rms']:.4g} Jy"
    return f"{change}, by more than its error (noise {two['rms_noise']:.4g} Jy, the data {two['rms_zero']:.4g} Jy)"
