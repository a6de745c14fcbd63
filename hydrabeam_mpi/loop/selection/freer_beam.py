"""What is claimed with a beam that is less free than stated must not be denied by one that is as free."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hydrabeam_mpi.fit.beams_given import solve_beams
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.state import Estimate, Fitted
from hydrabeam_mpi.mpi import together


def refusal_by_freer_beam(context: FitContext, before: Fitted, after: Fitted) -> str | None:
    """Say that the data speak against an effect, as it was fitted, where the beam is as free as the job states.

    A prior that is as narrow as the data want finds what a freer beam takes up. It may also be wrong in detail, which
    an effect then seems to explain. So the evidence with the stated widths is asked which is likelier, the effect as it
    was fitted or none. Where the beam takes up nearly all of it that says little, but it says on which side of half the
    effect the data are: of what is so mostly on its side, of what is not as often on the other, the more often the
    larger it is.

    None where it says nothing against the effect, or the beam has no widths less than the stated ones. Collective: all
    ranks of the grid.
    """
    if not _is_less_free(context, after):
        return None
    gain = _log_evidence(context, after) - _log_evidence(context, before)
    if gain >= 0:
        return None
    return f"with a beam as free as is stated the data are likelier without it (ln BF {gain:.4g})"


def _is_less_free(context: FitContext, fitted: Fitted) -> bool:
    """Whether any width of the beams' prior is less than the stated one. Collective: all ranks of the grid."""
    is_less = False
    with together(context.grid.world):
        if fitted.values.prior_widths is not None:
            priors = zip(context.given(fitted.values).priors, context.problem.priors, strict=True)
            is_less = any(bool(np.any(now.std() < stated.std())) for now, stated in priors)
    return any(context.grid.world.allgather(is_less))


def _log_evidence(context: FitContext, fitted: Fitted) -> float:
    """Return ln evidence of beams as free as is stated, given the effects as they are fitted."""
    at = Estimate(replace(fitted.values, prior_widths=None), fitted.estimate.beams)
    evidences = [one.log_evidence for one in solve_beams(context, at).beams]
    return context.over_channels(np.array([np.nan if one is None else one for one in evidences]))
