"""Which element of an effect matters most, such as one of the sources that its candidates may be: fits tell."""

from __future__ import annotations

from itertools import islice

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray, IntArray
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import BrokenOff, Worth
from hydrabeam_mpi.fit.state import Active, Fitted
from hydrabeam_mpi.loop.attribution.reconsider import reconsider
from hydrabeam_mpi.loop.attribution.score_effects import Finding, weigh_as_they_are
from hydrabeam_mpi.loop.rules import RULES
from hydrabeam_mpi.loop.selection.physical import leave_out_unphysical
from hydrabeam_mpi.loop.selection.refits import both, fit_patiently, is_same_prior, log_joint, may_surpass, restarted


def started(context: FitContext, finding: Finding, prior_var: FloatArray) -> Active:
    """Return an effect where its fit begins, with a prior of variances (n_params,).

    What else it needs there is as large beforehand as it is where the fit begins.
    """
    x = np.where(prior_var > 0, finding.evidence.x, 0.0)
    effect, own, needed = finding.effect.needed_at(context.setup, x)
    n = len(needed)
    of_all, all_x = np.zeros(n), np.zeros((*x.shape[:-1], n))
    of_all[own], all_x[..., own] = prior_var, x
    begun = effect.begun(context.setup, all_x)
    if needed.any():
        of_all[needed] = np.mean(begun[..., needed] ** 2)
    return Active.start(effect, context.setup, of_all, begun)


def fit_foremost(context: FitContext, before: Fitted, finding: Finding, worth: Worth | None = None) -> Fitted | None:
    """Fit the one element that matters most, such as a source; None where that says nothing of the others.

    Where candidates lie on a grid a bright source beside its place is made up for by several, which are hardly told
    from each other, so that a fit of all may go anywhere. Once the first is where it belongs the others are weighed
    again. Which is the first only fits tell where several come near by the linear model, as those at the grating lobes
    of a regular array do. Where one alone was found, what is not ``worth`` it is broken off, wherever that one may be.
    """
    best: Fitted | None = None
    if len(_elements_in_use(context, finding)) > 1:
        worth = None
    for prior_var in _each_foremost(context, finding):
        best = _or_begun_at(context, before, best, started(context, finding, prior_var), worth)
    if best is None:
        return None
    for start in _elsewhere(context, before, best.values.active[-1]):
        best = _or_begun_at(context, before, best, start, worth)
    return best


def _elsewhere(context: FitContext, before: Fitted, last: Active) -> list[Active]:
    """Return where else the element that an effect has may be, such as in grating lobes, the likeliest place first.

    Places follow from where it has been fitted, so that it is as good as linear there: those by far less likely than
    the likeliest of them are left out.
    """
    element = int(last.effect.parameters(context.setup).element[last.used[0]])
    places = list(islice(last.effect.alike(context.setup, last.x, element), RULES.most_places))
    alone = []
    for effect, evidence in zip(places, weigh_as_they_are(context, before, places) if places else (), strict=True):
        alone.append(float(evidence.alone[effect.parameters(context.setup).element == element].max()))
    prior_var, x = last.prior_var(context.setup), np.zeros_like(last.x)
    return [
        Active.start(places[number], context.setup, prior_var, x)
        for number in np.argsort(-np.array(alone), kind="stable").tolist()
        if alone[number] >= RULES.near_if_linear * max(alone)
    ]


def _or_begun_at(
    context: FitContext, before: Fitted, best: Fitted | None, start: Active, worth: Worth | None
) -> Fitted | None:
    """Fit an effect from another start, and return the best fit so far or that one, where it is physical and likelier.

    Collective: all ranks of the grid.
    """
    if best is not None:
        worth = both(worth, may_surpass(log_joint(context, best)))
    try:
        fitted = fit_patiently(context, before.values.extended(start), before, worth)
    except BrokenOff:
        return best
    physical = _physical_as_wanted(context, before, fitted) if fitted.diagnostics.converged else None
    if best is None or physical is None:
        return best or physical
    return max(best, physical, key=lambda one: log_joint(context, one))


def _physical_as_wanted(context: FitContext, before: Fitted, fitted: Fitted) -> Fitted | None:
    """Return a fit if it is physical, or with the prior that it wants; None where it is not with either.

    With a prior that the linear model has found, which may be many times too narrow, a beam can take up what a source
    should be. Collective: all ranks of the grid.
    """
    n_before = len(before.values.active)
    if leave_out_unphysical(context, fitted, n_before) is None:
        return fitted
    last = fitted.values.active[-1]
    now = last.prior_var(context.setup)
    wanted = np.where(now > 0, reconsider(context, fitted).prior_var, 0.0)
    if not wanted.any() or is_same_prior(wanted, now):
        return None
    try:
        again = fit_patiently(context, before.values.extended(restarted(context, last, wanted)), fitted)
    except BrokenOff:
        return None
    is_physical = again.diagnostics.converged and leave_out_unphysical(context, again, n_before) is None
    return again if is_physical else None


def _each_foremost(context: FitContext, finding: Finding) -> list[FloatArray]:
    """Return priors, variances (n_params,), of each element that may matter most, the likeliest first.

    Empty where there is only one, or where candidates do not lie on a grid.
    """
    effect, evidence = finding.effect, finding.evidence
    parameters, is_wanted = effect.parameters(context.setup), evidence.prior_var > 0
    if not (effect.gets_simpler_when_fitted and len(evidence.alone) and is_wanted.any()):
        return []
    element = parameters.element
    alone = np.full(int(element.max()) + 1, -np.inf)
    np.maximum.at(alone, element, evidence.alone)
    order = np.argsort(-alone, kind="stable")[: RULES.most_tries]
    near = order[alone[order] >= RULES.near * alone.max()]
    if len(_elements_in_use(context, finding)) < 2 and len(near) < 2:
        return []
    # What was not chosen beside the others may be as large as what was.
    largest = np.max(evidence.prior_var[is_wanted] / parameters.scale[is_wanted] ** 2)
    as_large = np.where(parameters.nonlinear, 0.0, largest * parameters.scale**2)
    prior_var = np.where(is_wanted, evidence.prior_var, as_large)
    return [np.where(element == one, prior_var, 0.0) for one in near.tolist()]


def _elements_in_use(context: FitContext, finding: Finding) -> IntArray:
    """Return the numbers of the elements that the linear model wants."""
    element = finding.effect.parameters(context.setup).element
    return np.asarray(np.unique(element[finding.evidence.prior_var > 0]))
