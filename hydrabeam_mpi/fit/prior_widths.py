"""Fits whose beams have the prior that the data want, by the evidence of its widths."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from hydrabeam_mpi.fit.common_widths import with_common_widths
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.gauss_newton import refit
from hydrabeam_mpi.fit.state import Fitted
from hydrabeam_mpi.fit.widths_evidence import WidthsEvidence, WidthsFound
from hydrabeam_mpi.inference.mode_widths import PriorWidths

MOST_TIMES = 3
"""That widths and effects are adapted to each other; without effects the first is exact."""


def is_adaptable(context: FitContext) -> bool:
    """Whether the beams' prior is of independent coefficients whose widths the job states."""
    return context.problem.has_adaptable_widths and context.learned is None


def as_stated(widths: PriorWidths) -> dict[str, Any]:
    """Return the keys of ``[prior]`` by which a job states these widths."""
    smooth = {"amplitude": widths.amplitude, "decay": list(widths.decay)}
    azimuthal = list(widths.azimuthal)
    return {"fraction": widths.fraction, "neighbours": widths.neighbours, "azimuthal": azimuthal, "smooth": smooth}


def adapted(
    context: FitContext, fitted: Fitted, found: WidthsFound, fit: Callable[..., Fitted] = refit, wider: bool = False
) -> tuple[Fitted, WidthsFound]:
    """Return a fit with the widths that were found, or better ones, and what is said of them in the end.

    Collective: all ranks of the grid. ``fit`` takes what `refit` does; ``wider`` as of `WidthsEvidence.best`.
    """
    for _ in range(MOST_TIMES):
        if found.gain < context.problem.job.loop.min_log_bayes_factor:
            break
        fitted = fit(context, replace(fitted.values, prior_widths=found.widths), fitted)
        if not fitted.values.active:  # which would have followed
            return fitted, replace(found, gain=0.0)
        if not wider and (values := with_common_widths(context, fitted)) is not None:
            fitted = fit(context, values, fitted)
        found = WidthsEvidence(context, fitted).best(wider)
    return fitted, found


def adapted_if_asked(context: FitContext, fitted: Fitted) -> Fitted:
    """Return a fit with the widths that the data want, where the job asks for these. Collective: all ranks."""
    if context.problem.job.prior.widths == "evidence":
        fitted, _ = adapted(context, fitted, WidthsEvidence(context, fitted).best())
    return fitted


def with_adapted_prior(context: FitContext, fitted: Fitted) -> tuple[FitContext, Fitted]:
    """Return context and fit of a problem that states the widths which `adapted_if_asked` finds.

    Collective: all ranks of the grid.
    """
    fitted = adapted_if_asked(context, fitted)
    if fitted.values.prior_widths is None:
        return context, fitted
    context = replace(context, problem=context.problem.with_prior_widths(fitted.values.prior_widths))
    return context, refit(context, replace(fitted.values, prior_widths=None), fitted)
