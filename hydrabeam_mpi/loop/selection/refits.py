"""Fits of effects that are part of the model: with other priors, with shorter steps, and what they gain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.fit.beams_given import total_log_joint
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import BrokenOff, Worth, refit
from hydrabeam_mpi.fit.state import Active, Ended, Fitted, Values
from hydrabeam_mpi.loop.attribution.score_noise import heavy_tails
from hydrabeam_mpi.loop.rules import RULES


def restarted(context: FitContext, active: Active, prior_var: FloatArray) -> Active:
    """Return an effect where it has been fitted, with another prior: variances ``prior_var``, (n_params,)."""
    nonlinear = active.effect.parameters(context.setup).nonlinear
    start = np.where((prior_var > 0) | nonlinear, active.x, 0.0)
    return Active.start(active.effect, context.setup, prior_var, start)


def is_same_prior(one: FloatArray, two: FloatArray) -> bool:
    """Tell whether two priors, variances (n_params,), have the same parameters in use, within a factor of two.

    A prior that is off by as much costs a parameter that the data tell 0.15 nats at most.
    """
    used = one > 0
    return np.array_equal(used, two > 0) and bool(np.all(np.abs(np.log2(one[used] / two[used])) <= 1.0))


def fit_patiently(context: FitContext, values: Values, before: Fitted, worth: Worth | None = None) -> Fitted:
    """Fit, and again with a shorter first step where that gets stuck; return what is likelier then.

    It goes as far as evidence tells. Arguments and what is raised are those of `refit`. Collective: all ranks of the
    grid.
    """
    fitted = refit(context, values, before, worth=worth, for_evidence=True)
    if fitted.diagnostics.ended is not Ended.STUCK:
        return fitted
    again = refit(context, values, before, RULES.first_step, worth, for_evidence=True)
    return again if again.diagnostics.converged or rise(context, fitted, again, of_nonlinear=True) > 0 else fitted


def fit_anew(context: FitContext, values: Values, before: Fitted) -> Fitted:
    """Fit effects of which some parameters are no longer in use; arguments are those of `refit`.

    Without these all rows may seem to be outliers at first, and be left out. So rows far out count less until the other
    parameters have followed. Collective: all ranks of the grid.
    """
    if any(one.change.leaves_out for one in values.reweighted):
        others = tuple(one for one in values.reweighted if not one.change.leaves_out)
        robust = refit(context, replace(values, reweighted=(*others, heavy_tails(context))), before)
        values, before = replace(robust.values, reweighted=values.reweighted), robust
    return fit_patiently(context, values, before)


def with_best_variant(context: FitContext, fitted: Fitted, place: int = -1) -> Fitted:
    """Fit the last effect, or the one at ``place``, in its other forms; return the likeliest; see `Effect.variants`.

    One that does not come near the best so far is broken off.
    Collective: all ranks of the grid.
    """
    best, active = fitted, fitted.values.active
    one = active[place]
    for effect in one.effect.variants(context.setup):
        other = Active.start(effect, context.setup, one.prior_var(context.setup), one.x)
        values = replace(fitted.values, active=tuple(other if each is one else each for each in active))
        try:
            again = fit_patiently(context, values, fitted, may_surpass(log_joint(context, best)))
        except BrokenOff:
            continue
        best = max(best, again, key=lambda each: log_joint(context, each))
    if best is fitted or best.diagnostics.converged:
        return best
    # Another form may begin far from where it ends.
    again = fit_patiently(context, best.values, best)
    return max(best, again, key=lambda each: log_joint(context, each))


def may_surpass(least: float) -> Worth:
    """Return what says whether a fit may end with an ln(likelihood x prior) above ``least``; see `Rules.near`."""
    return lambda at: at.reached + at.expected / RULES.near > least


def both(one: Worth | None, two: Worth) -> Worth:
    """Return what says whether a fit is worth it by either."""
    return two if one is None else lambda at: one(at) and two(at)


def rise(context: FitContext, before: Fitted, after: Fitted, of_nonlinear: bool = False) -> float:
    """Return by how much ln(likelihood x prior) is higher; see `total_log_joint`. Collective: all ranks of the grid."""
    return log_joint(context, after, of_nonlinear) - log_joint(context, before, of_nonlinear)


def log_joint(context: FitContext, fitted: Fitted, of_nonlinear: bool = True) -> float:
    """Return ln(likelihood x prior) of a fit; see `total_log_joint`. Collective: all ranks of the grid."""
    return total_log_joint(context, fitted.values, fitted.diagnostics.log_joint, of_nonlinear)
