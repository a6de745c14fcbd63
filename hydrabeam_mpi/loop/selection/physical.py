"""Parts of effects that cannot be: fluxes below zero, transmissions that are not between 0 and 1."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hydrabeam_mpi.data.observation import BoolArray
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.error_scale import error_scale
from hydrabeam_mpi.fit.state import Active, Fitted, Values
from hydrabeam_mpi.loop.attribution.limits import is_unphysical

MOST_NAMED = 4
"""Parameters that a line names, those furthest beyond their limits: of many sources it would be pages."""


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


def leave_out_unphysical(context: FitContext, fitted: Fitted, n_before: int) -> LeftOut | None:
    """Leave single elements (a source, a wall) out of effects after the first ``n_before`` if they are unphysical.

    Collective: all ranks of the grid. Others are left to be fitted again, as they may stand for what is true; what was
    left out cannot be chosen again. None where there is nothing to leave out.
    """
    # While something is left that the model lacks, what is true is moved by it, such as a wall that hides everything.
    active, scale = fitted.values.active, error_scale(context, fitted)
    kept: list[Active] = []
    places: dict[int, int | None] = {}
    told = []
    for place, (one, by_noise) in enumerate(zip(active, fitted.fit.std, strict=True)):
        left: Active | None = one
        std = scale.of(one, by_noise)
        beyond = one.effect.beyond(context.setup, one.x, std) if place >= n_before and one.size else np.zeros(0)
        gone = is_unphysical(beyond, context.problem.job.loop.min_log_bayes_factor)
        if gone.any():
            known = one.effect.parameters(context.setup)
            which = np.flatnonzero(gone)[np.argsort(-beyond[gone], kind="stable")]
            each = [
                f"{known.names[i]} {one.x[:, i].mean():.4g} +- {std[:, i].mean():.2g} {known.units[i]}".rstrip()
                for i in which[:MOST_NAMED]
            ]
            each += [f"and {len(which) - MOST_NAMED} more"] if len(which) > MOST_NAMED else []
            told.append(f"{one.effect.title}: left out what would have {one.effect.unphysical}: {', '.join(each)}")
            left = _rest(context, one, gone)
        places[place] = None if left is None else len(kept)
        kept += [] if left is None else [left]
    return LeftOut(replace(fitted.values, active=tuple(kept)), places, tuple(told)) if told else None


def price_of_fitted(context: FitContext, fitted: Fitted) -> float:
    """Return the nats that it costs the last effect that parts of it are beyond their limits, if by little, or move.

    A Gaussian prior knows no limits. The most probable values within them are at the limit, where ln likelihood is
    less by beyond^2 / 2 for each part. Collective: all ranks of the grid.
    """
    one, by_noise = fitted.values.active[-1], fitted.fit.std[-1]
    std = error_scale(context, fitted).of(one, by_noise)
    beyond = one.effect.beyond(context.setup, one.x, std)
    motion = one.effect.price_of_motion(context.setup, one.x, by_noise)
    return float(0.5 * np.sum(beyond[np.isfinite(beyond)] ** 2)) + motion


def _rest(context: FitContext, one: Active, gone: BoolArray) -> Active | None:
    """Return an effect without some of its parameters; None where none of those left is in use."""
    effect, left = one.effect.without(gone)
    prior_var = one.prior_var(context.setup)[left]
    return Active.start(effect, context.setup, prior_var, one.x[:, left]) if prior_var.any() else None
