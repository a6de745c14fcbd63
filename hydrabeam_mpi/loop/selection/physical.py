"""Parts of effects that cannot be: fluxes below zero, transmissions that are not between 0 and 1."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hydrabeam_mpi.data.observation import BoolArray, FloatArray
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.error_scale import error_scale
from hydrabeam_mpi.fit.gauss_newton import BrokenOff, refit
from hydrabeam_mpi.fit.joint_step import HELD
from hydrabeam_mpi.fit.state import Active, Fitted, Values
from hydrabeam_mpi.inference.prior import ChannelPrior, DiagonalPrior
from hydrabeam_mpi.loop.attribution.limits import is_unphysical
from hydrabeam_mpi.loop.selection.refits import log_joint

MOST_NAMED = 4
"""Parameters that a line names, those furthest beyond their limits: of many sources it would be pages."""
WITHIN = HELD**-0.5
"""Part of its prior's width within which a parameter is held, as what is degenerate is."""


@dataclass(frozen=True)
class LeftOut:
    """The model without what is unphysical in it, still to be fitted.

    Attributes
    ----------
    values : Values
    places : dict
        Where each active effect is now, by where it was; None where nothing is left of it.
    told : tuple of str
        What was left out of each effect, and why.
    """

    values: Values
    places: dict[int, int | None]
    told: tuple[str, ...]


def may_be_unphysical(context: FitContext, one: Active) -> bool:
    """Whether something of an effect is beyond its limits where it is, by however little.

    Of what has places or indices to fit, which are nonlinear, nothing is known before a fit.
    """
    if np.any(one.effect.parameters(context.setup).nonlinear):
        return False
    in_use = np.zeros_like(one.x)
    in_use[:, one.used] = 1.0
    return bool(np.any(one.effect.beyond(context.setup, one.x, in_use) > 0))


def leave_out_unphysical(
    context: FitContext, fitted: Fitted, n_before: int, by_likelihood: bool = False
) -> LeftOut | None:
    """Leave single elements (a source, a wall) out of effects after the first ``n_before`` if they are unphysical.

    That is by their errors, or ``by_likelihood`` also where what is beyond a limit by less costs more than is believed;
    see `price_of_limits`. Others are left to be fitted again, as they may stand for what is true; what was left out
    cannot be chosen again. None where there is nothing to leave out. Collective: all ranks of the grid.
    """
    # While something is left that the model lacks, what is true is moved by it, such as a wall that hides everything.
    active, scale = fitted.values.active, error_scale(context, fitted)
    nats = context.problem.job.loop.min_log_bayes_factor
    kept: list[Active] = []
    places: dict[int, int | None] = {}
    told = []
    for place, (one, by_noise) in enumerate(zip(active, fitted.fit.std, strict=True)):
        left: Active | None = one
        std = scale.of(one, by_noise)
        beyond = one.effect.beyond(context.setup, one.x, std) if place >= n_before and one.size else np.zeros(0)
        gone = is_unphysical(beyond, nats)
        if by_likelihood and beyond.any() and not gone.any() and price_of_limits(context, fitted, place) > nats:
            gone = beyond == beyond.max()
        if gone.any():
            known = one.effect.parameters(context.setup)
            which = np.flatnonzero(gone)[np.argsort(-beyond[gone], kind="stable")]
            each = [
                f"{known.names[i]} {one.x[:, i].mean():.4g} +- {std[:, i].mean():.2g} {known.units[i]}".rstrip()
                for i in which[:MOST_NAMED]
            ]
            each += [f"and {len(which) - MOST_NAMED} more"] if len(which) > MOST_NAMED else []
            told.append(f"{one.effect.title}: left out what would have {one.effect.unphysical}: {', '.join(each)}")
            left = rest_of(context, one, gone)
        places[place] = None if left is None else len(kept)
        kept += [] if left is None else [left]
    return LeftOut(replace(fitted.values, active=tuple(kept)), places, tuple(told)) if told else None


def price_of_fitted(context: FitContext, fitted: Fitted) -> float:
    """Return the nats that it costs the last effect that parts of it are beyond their limits, if by little, or move.

    Collective: all ranks of the grid.
    """
    one = fitted.values.active[-1]
    motion = one.effect.price_of_motion(context.setup, one.x, fitted.fit.std[-1])
    return price_of_limits(context, fitted, len(fitted.values.active) - 1) + motion


def price_of_limits(context: FitContext, fitted: Fitted, place: int) -> float:
    """Return the nats that it costs an effect that parts of it are beyond their limits, if by little.

    A Gaussian prior knows no limits. The most probable values within them are at the limit: it costs what ln(likelihood
    x prior) is less there, with all else fitted again, in units of what is left of the data as all errors are. Where a
    product of flux and beam counts, a flux may be thousands of Jy below zero and within two of its errors of it, as its
    beam has the other sign; a beam and a flux of zero are then another matter. Collective: all ranks of the grid.
    """
    active, scale = fitted.values.active, error_scale(context, fitted)
    one = active[place]
    beyond = one.effect.beyond(context.setup, one.x, scale.of(one, fitted.fit.std[place]))
    if not np.any(beyond > 0):
        return 0.0
    by_errors = float(0.5 * np.sum(beyond[np.isfinite(beyond)] ** 2))
    at_limit = _held_at_limit(context, one)
    if at_limit is None:
        return by_errors
    values = replace(fitted.values, active=(*active[:place], at_limit, *active[place + 1 :]))
    try:
        there = refit(context, values, fitted, for_evidence=True)
    except BrokenOff:
        return by_errors
    # The prior that counts is that of the effect, not the one by which it is held.
    held = replace(there.values.active[place], prior=one.prior)
    of_all = there.values.active
    same = replace(there.values, active=(*of_all[:place], held, *of_all[place + 1 :]))
    less = log_joint(context, fitted) - log_joint(context, replace(there, values=same))
    return max(less, 0.0) / float(np.mean(scale.of_blocks(one.effect) ** 2))


def _held_at_limit(context: FitContext, one: Active) -> Active | None:
    """Return an effect with what is beyond its limits at them, where it is held.

    None where limits are of several parameters together, or priors couple these.
    """
    priors = one.prior.priors
    if one.prior.n_coupled or not all(isinstance(prior, DiagonalPrior) for prior in priors):
        return None
    x, in_use = one.x.copy(), np.zeros(one.x.shape[1])
    in_use[one.used] = 1.0
    for of_channel in x:
        excess = _excess(context, one.effect, of_channel, in_use)
        where = np.isfinite(excess) & (excess > 0)
        if not np.all(where[excess > 0]):
            return None
        for sign in (1.0, -1.0):
            there = of_channel + sign * excess
            inside = where & (_excess(context, one.effect, there, in_use) <= WITHIN * excess)
            of_channel[inside] = there[inside]
            where &= ~inside
        if where.any():
            return None
    held = np.any(x != one.x, axis=0)[one.used]
    of_channels = [priors[min(f, len(priors) - 1)] for f in range(1 if one.prior.shared else len(x))]
    narrow = tuple(
        DiagonalPrior(np.where(held, x[f, one.used], prior.mean), np.where(held, WITHIN, 1.0) * prior.std())
        for f, prior in enumerate(of_channels)
    )
    return replace(one, x=x, prior=ChannelPrior(narrow, one.prior.shared))


def _excess(context: FitContext, effect: Effect, x: FloatArray, in_use: FloatArray) -> FloatArray:
    """Return by how much a channel's parameters, (n_params,), are beyond their limits."""
    return effect.beyond(context.setup, x[np.newaxis], in_use[np.newaxis])


def rest_of(context: FitContext, one: Active, gone: BoolArray) -> Active | None:
    """Return an effect without some of its parameters; None where none of those left is in use."""
    effect, left = one.effect.without(gone)
    prior_var = one.prior_var(context.setup)[left]
    return Active.start(effect, context.setup, prior_var, one.x[:, left]) if prior_var.any() else None
