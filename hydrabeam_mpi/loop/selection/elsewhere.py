"""Where else a part of an effect may be as well: a regular array sees what moves, or stands, alike in its lobes."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice

import numpy as np

from hydrabeam_mpi.data.observation import BoolArray
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.error_scale import error_scale
from hydrabeam_mpi.fit.gauss_newton import BrokenOff
from hydrabeam_mpi.fit.state import Active, Fitted
from hydrabeam_mpi.loop.rules import RULES
from hydrabeam_mpi.loop.selection.acceptance import Elsewhere
from hydrabeam_mpi.loop.selection.first_and_last import settle_last
from hydrabeam_mpi.loop.selection.history import History
from hydrabeam_mpi.loop.selection.physical import leave_out_unphysical
from hydrabeam_mpi.loop.selection.predictions import check
from hydrabeam_mpi.loop.selection.refits import fit_patiently, log_joint, may_surpass


def tell_elsewhere(context: FitContext, history: History) -> None:
    """Fit each part of what the loop claims where it is seen alike, and remember what data do not tell from it.

    That is what is less likely by less than the evidence that the job asks for. What is likelier after all becomes the
    last fit. Collective: all ranks of the grid.
    """
    for number, one in enumerate(history.rounds):
        if one.place is None or one.given_up:
            continue
        found = _of_effect(context, history.last.fitted, one.place)
        if found and found[0][0].log_likelihood_ratio > 0:
            history.last = check(context, found[0][1])
            settle_last(context, history)
            found = _of_effect(context, history.last.fitted, one.place)
        elsewhere = tuple(other for other, _ in found)
        history.rounds[number] = replace(history.rounds[number], elsewhere=elsewhere)


def _of_effect(context: FitContext, fitted: Fitted, place: int) -> list[tuple[Elsewhere, Fitted]]:
    """Return where else parts of the effect at a place of the model may be, the likeliest first, and the fits there.

    Collective: all ranks of the grid.
    """
    active, found = fitted.values.active[place], list[tuple[Elsewhere, Fitted]]()
    elements = active.effect.parameters(context.setup).element
    scale = float(np.mean(error_scale(context, fitted).of_blocks(active.effect) ** 2))
    here = log_joint(context, fitted)
    # Of ln likelihood, in units of what is left of the data.
    least = here - scale * context.problem.job.loop.min_log_bayes_factor
    for element in np.unique(elements[active.used]).tolist():
        own = elements == element
        for effect in islice(active.effect.alike(context.setup, active.x, element), RULES.most_places):
            start = replace(active, effect=effect, x=np.where(own, 0.0, active.x))
            other = _fit_there(context, fitted, place, start, least)
            if other is not None:
                ratio = (log_joint(context, other) - here) / scale
                found.append((_as_told(context, other, place, own, ratio), other))
    return sorted(found, key=lambda one: -one[0].log_likelihood_ratio)


def _fit_there(context: FitContext, fitted: Fitted, place: int, start: Active, least: float) -> Fitted | None:
    """Fit with another form of an effect; None where that does not come to ``least``, or cannot be."""
    before = fitted.values.active
    values = replace(fitted.values, active=(*before[:place], start, *before[place + 1 :]))
    try:
        other = fit_patiently(context, values, fitted, may_surpass(least))
    except BrokenOff:
        return None
    is_physical = other.diagnostics.converged and leave_out_unphysical(context, other, place) is None
    return other if is_physical and log_joint(context, other) > least else None


def _as_told(context: FitContext, fitted: Fitted, place: int, own: BoolArray, ratio: float) -> Elsewhere:
    """Describe one part of an effect as it was fitted."""
    active = fitted.values.active[place]
    std = error_scale(context, fitted).of(active, fitted.fit.std[place])
    told = active.effect.told(context.setup, active.x, std)
    which = np.flatnonzero(own & np.isin(np.arange(len(own)), active.used)).tolist()
    freqs = [None] if active.effect.shared else context.setup.observation.freqs.tolist()
    parameters = tuple(
        {
            "name": told.names[i], "unit": told.units[i], "value": float(told.values[f, i]),
            "std": float(told.std[f, i]), "freq_hz": freq,
        }
        for f, freq in enumerate(freqs)
        for i in which
    )  # fmt: skip
    return Elsewhere(ratio, parameters)
