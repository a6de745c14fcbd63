"""Steps that learn from those before: Anderson acceleration (Anderson 1965; Walker and Ni 2011).

A Gauss-Newton step leaves out how the columns of the effects change with the parameters, times the residual. Where the
residual is large, as it is while something else is missing, steps are then several times too short or too long along
some directions, and go on for dozens of times. How steps have changed from point to point tells these directions: from
the points so far that combination is taken whose step is the smallest, and that step from there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.joint_step import limited
from hydrabeam_mpi.fit.state import Estimate, Fit
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.mpi import bcast_object

MEMORY = 5
"""Earlier steps that are looked at: as many slow directions at once. More hardly help, and are of far away."""
RCOND = 1e-6
"""Below this fraction of the largest, differences between steps are those of their rounding and of their limits."""
AHEAD = 2.0
"""Times the proposed step, where those before tell nothing but that it is too short."""


class EarlierSteps:
    """The latest points of a fit, and the steps that were proposed there."""

    def __init__(self) -> None:
        self._points: list[FloatArray] = []
        self._steps: list[FloatArray] = []

    def forget(self) -> None:
        """Begin anew."""
        self._points, self._steps = [], []

    def accelerated(self, point: FloatArray, step: FloatArray, std: FloatArray) -> FloatArray | None:
        """Return a better step than the one that is proposed; None without earlier ones.

        Parameters
        ----------
        point, step : ndarray, (Nfreqs, q)
            Where the parameters are, and the Gauss-Newton step from there; both are remembered.
        std : ndarray, (Nfreqs, q)
            By which differences count.
        """
        self._points = [*self._points[-MEMORY:], point]
        self._steps = [*self._steps[-MEMORY:], step]
        if len(self._points) == 1:
            return None
        moved, changed = (np.diff(one, axis=0) for one in (self._points, self._steps))
        # Of what data hardly constrain the variance may be no more than rounding errors, of either sign.
        per_std = np.where(std > 0, 1 / np.where(std > 0, std, 1.0), 0.0)
        in_sigmas = (changed * per_std).reshape(len(changed), -1).T
        weights = np.linalg.lstsq(in_sigmas, (step * per_std).ravel(), rcond=RCOND)[0]
        better = np.asarray(step - np.tensordot(weights, moved + changed, axes=1))
        # Away from a saddle steps get longer; the smallest one is back there.
        return better if np.sum(better * step * per_std**2) > 0 else AHEAD * step


def accelerated(context: FitContext, at: Estimate, to: Estimate, fit: Fit, earlier: EarlierSteps) -> Estimate | None:
    """Return where a step leads with what earlier ones tell, each parameter within its limit; None if that is nothing.

    Nor is it anything where channels hang together. Collective: all ranks of the grid.

    Parameters
    ----------
    context : FitContext
    at, to : Estimate
        Where the step begins, and where it leads by itself.
    fit : Fit
        What it tells of the effects.
    earlier : EarlierSteps
        On the grid's root they are known.
    """
    values, change = at.values, None
    if not values.active or context.problem.coupling is not None:
        return None
    if context.grid.is_world_root:
        std = np.concatenate([one[:, i.used] for one, i in zip(fit.std, values.active, strict=True)], axis=1)
        wanted = earlier.accelerated(values.x, to.values.x - values.x, std)
        change = None if wanted is None else np.array([limited(values, one) for one in wanted])
    change = bcast_object(context.grid.world, change)
    if change is None:
        return None
    return Estimate(values.at(values.x + change), followed(context, at.beams, fit.beam_response, change))


def followed(
    context: FitContext, beams: Sequence[Posterior], response: Sequence[Array], change: FloatArray
) -> tuple[Posterior, ...]:
    """Return the rank group's beams where they belong to parameters that ``change``, (Nfreqs, q)."""
    each = zip(beams, response, context.channels, strict=True)
    return tuple(replace(one, mean=one.mean + by_effects @ change[f]) for one, by_effects, f in each)
