"""Fits of candidates: exactly, jointly with all that is known, and with no more parameters than the evidence wants."""

from __future__ import annotations

from dataclasses import dataclass, replace

from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.interface.reweighting import ReweightingFit
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import NOT_NEAR, BrokenOff, Underway, Worth, refit, stepped
from hydrabeam_mpi.fit.predictive_density import predictive_density
from hydrabeam_mpi.fit.state import Fitted, Reweighted, Values
from hydrabeam_mpi.loop.attribution.evidence import Evidence
from hydrabeam_mpi.loop.attribution.reconsider import Known, compare_priors
from hydrabeam_mpi.loop.attribution.score_effects import Finding, attribute, attribute_sizes
from hydrabeam_mpi.loop.attribution.score_noise import refit_reweighting
from hydrabeam_mpi.loop.rules import RULES
from hydrabeam_mpi.loop.selection.acceptance import Candidate, Checked
from hydrabeam_mpi.loop.selection.foremost import fit_foremost, started
from hydrabeam_mpi.loop.selection.physical import leave_out_unphysical, may_be_unphysical, price_of_fitted
from hydrabeam_mpi.loop.selection.predictions import check
from hydrabeam_mpi.loop.selection.refits import (
    fit_patiently,
    is_same_prior,
    log_joint,
    restarted,
    rise,
    with_best_variant,
)
from hydrabeam_mpi.mpi import bcast_object
from hydrabeam_mpi.terminal.progress import say


def as_large_as_wanted(context: FitContext, fitted: Fitted, candidate: Candidate) -> Candidate:
    """Take more parameters of an effect's sort at once, as long as that has more evidence. Collective: all ranks."""
    best = candidate.finding
    larger = bcast_object(context.grid.world, best.effect.larger(context.setup) if best is not None else ())
    if best is None or not larger:
        return candidate
    for effect in larger:
        (further,) = attribute_sizes(context, fitted, [effect])
        if further.evidence.log_bayes_factor <= best.evidence.log_bayes_factor:
            break
        best = further
    return replace(candidate, finding=best, log_bayes_factor=best.evidence.log_bayes_factor)


def fit_candidate(
    context: FitContext, checked: Checked, candidate: Candidate, worth: Worth | None = None
) -> tuple[Candidate, Checked]:
    """Fit a candidate and predict the held-out rows with it; ``worth`` as for `refit`.

    Collective: all ranks of the grid.
    """
    say(f"  trying {candidate.title} (ln BF {candidate.log_bayes_factor:.4g})", context.grid.is_world_root)
    fit = _fit_weights if candidate.finding is None else _fit_effect
    found, fitted = fit(context, checked.fitted, candidate, worth)
    if found.finding is not None:
        fitted = by_heldout(context, fitted)
        found = replace(found, finding=replace(found.finding, effect=fitted.values.active[-1].effect))
    after = check(context, fitted)
    told = f"held-out chi^2 {after.score.chi2:.4g}, rms {after.numbers.of_all['rms']:.4g} Jy"
    say(f"    {told} (ln BF {found.log_bayes_factor:.4g})", context.grid.is_world_root)
    return found, after


def by_heldout(context: FitContext, fitted: Fitted, place: int = -1) -> Fitted:
    """Let the held-out rows say what of an effect the fitted ones cannot, as they are the same with either.

    Such is a jump between two fitted times: it may be before or after those that lie between. Where each belongs no
    other decides, nor do rows of other times: each is asked of the density of those between alone. The effect is the
    last of the active ones, or the one at ``place``. Collective: all ranks of the grid.
    """
    active = fitted.values.active
    one = active[place]

    def with_effect(effect: Effect) -> Fitted:
        others = tuple(replace(other, effect=effect) if other is one else other for other in active)
        return replace(fitted, values=replace(fitted.values, active=others))

    moved = one.effect
    for number, (times, others) in enumerate(one.effect.alternatives(context.setup, one.used)):
        if not others:
            continue
        of_times = context.held_out_at(times)
        stays, *goes = (predictive_density(of_times, with_effect(effect)).log for effect in (one.effect, *others))
        best = max(range(len(others)), key=lambda which: goes[which])
        if goes[best] > stays:
            moved = moved.alternatives(context.setup, one.used)[number].others[best]
    return fitted if moved is one.effect else with_effect(moved)


@dataclass(frozen=True)
class TriedFit:
    """A fit of an effect, what weighing it again there says, and ln of its Bayes factor over the model without it.

    The Bayes factor is that of the prior with which it has been fitted. What weighing says may be of another one, and
    by so much more (``promised``) that one's may be higher.
    """

    fitted: Fitted
    evidence: Evidence
    log_bayes_factor: float
    promised: float

    @classmethod
    def of(cls, context: FitContext, before: Fitted, fitted: Fitted) -> TriedFit:
        """Weigh the effect again where it has been fitted. Collective: all ranks of the grid."""
        place, known = len(fitted.values.active) - 1, Known.of(context, fitted)
        own = fitted.values.active[place].prior_var(context.setup)
        wanted, given = compare_priors(context, fitted, known, place, own)
        gained, price = rise(context, before, fitted), price_of_fitted(context, fitted)
        promised = wanted.log_bayes_factor - given.log_bayes_factor
        return cls(fitted, wanted, gained - price - given.price, promised)

    def is_better(self, other: TriedFit) -> bool:
        """Whether it has more evidence than another one; a fit that has not converged is no evidence."""
        own, others = (one.fitted.diagnostics.converged for one in (self, other))
        return self.log_bayes_factor > other.log_bayes_factor if own == others else own


def _fit_effect(
    context: FitContext, before: Fitted, candidate: Candidate, worth: Worth | None
) -> tuple[Candidate, Fitted]:
    """Fit an effect, and again with the prior that it wants where it has been fitted, as no effect is quite linear.

    The best of these fits is taken, which need not be the last one. What is unphysical there is left out; `BrokenOff`
    is raised where that is all of the first.
    """
    assert candidate.finding is not None
    if candidate.begun is not None:
        fitted = _fit_physically(context, candidate.begun.values, candidate.begun, worth)
    elif (foremost := fit_foremost(context, before, candidate.finding, worth)) is not None:
        fitted = foremost
    else:
        fitted = _fit_in_some_form(context, before, candidate.finding, worth)
    best = latest = TriedFit.of(context, before, with_best_variant(context, fitted))
    # Of several elements the first was fitted whatever it alone comes to; now it is known what there is beside it. It
    # may be all that there is: then it costs less than the several that were weighed.
    reached = log_joint(context, latest.fitted)
    price = reached - log_joint(context, before) - latest.log_bayes_factor
    if worth is not None and not worth(Underway(reached, max(latest.promised, 0.0), (reached, reached), price)):
        raise BrokenOff(NOT_NEAR)
    for _ in range(RULES.most_refits):
        last, wanted = latest.fitted.values.active[-1], latest.evidence.prior_var
        if is_same_prior(wanted, last.prior_var(context.setup)):
            break
        values = before.values.extended(restarted(context, last, wanted))
        try:
            latest = TriedFit.of(context, before, _fit_physically(context, values, latest.fitted, worth))
        except BrokenOff:
            break
        best = latest if latest.is_better(best) else best
    effect = best.fitted.values.active[-1].effect
    finding = Finding(effect, best.evidence.with_gain(best.log_bayes_factor + best.evidence.price))
    return replace(candidate, finding=finding, log_bayes_factor=best.log_bayes_factor), best.fitted


def _fit_in_some_form(context: FitContext, before: Fitted, finding: Finding, worth: Worth | None) -> Fitted:
    """Fit an effect in the form that has the most evidence by the linear model, or in the next one that is worth it.

    It has been weighed in one form alone, and another may explain what that one does not come near to.
    """
    variants = finding.effect.variants(context.setup)
    forms = [finding, *(attribute(context, before, variants) if variants else ())]
    forms.sort(key=lambda one: -one.evidence.log_bayes_factor)
    while True:
        form = forms.pop(0)
        start = started(context, form, form.evidence.prior_var)
        try:
            return _fit_physically(context, before.values.extended(start), before, worth)
        except BrokenOff:
            if not forms:
                raise


def _fit_physically(context: FitContext, values: Values, before: Fitted, worth: Worth | None) -> Fitted:
    """Fit, and again without those parts of the last effect that are unphysical, until none is.

    What is so at the linear optimum, where the values are, is left out before the first fit.
    """
    while may_be_unphysical(context, values.active[-1]):
        fitted = stepped(context, values, before)
        rest = _physical(context, fitted)
        if rest is None:
            break
        values = rest
    fitted = fit_patiently(context, values, before, worth)
    while (rest := _physical(context, fitted)) is not None:
        fitted = fit_patiently(context, rest, fitted, worth)
    return fitted


def _physical(context: FitContext, fitted: Fitted) -> Values | None:
    """Leave out what is unphysical of the last effect; None where nothing is. Collective: all ranks of the grid."""
    n_before = len(fitted.values.active) - 1
    found = leave_out_unphysical(context, fitted, n_before)
    if found is None:
        return None
    for line in found.told:
        say(f"    {line}", context.grid.is_world_root)
    if len(found.values.active) == n_before:
        raise BrokenOff(f"all that is left of it would have {fitted.values.active[-1].effect.unphysical}")
    return found.values


def _fit_weights(
    context: FitContext, before: Fitted, candidate: Candidate, worth: Worth | None
) -> tuple[Candidate, Fitted]:
    """Fit with changed weights, then fit the noise scales again to the residuals."""
    assert candidate.weights is not None
    found = candidate.weights

    def weighted(start: Fitted, fit: ReweightingFit) -> Fitted:
        added = Reweighted(found.change, fit.x, fit.std)
        return refit(context, replace(start.values, reweighted=(*before.values.reweighted, added)), start)

    fit = found.fit
    fitted = weighted(found.start, fit)
    for _ in range(found.change.times_refitted):
        fit = refit_reweighting(context, fitted, found.change)
        fitted = weighted(fitted, fit)
    weights = replace(found, fit=replace(fit, log_bayes_factor=found.fit.log_bayes_factor))
    return replace(candidate, weights=weights), fitted
