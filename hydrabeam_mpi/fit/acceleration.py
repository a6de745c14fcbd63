"""Steps that learn from those before: Anderson acceleration (Anderson 1965; Walker and Ni 2011).

A Gauss-Newton step leaves out how the columns of the effects change with the parameters, times the residual, and that
E changes with the beams. Where the residual is large, as it is while something else is missing, or E is strong, steps
are then several times too short or too long along some directions, and go on for dozens of times. How steps have
changed from point to point tells these directions: from the points so far that combination is taken whose step is the
smallest, and that step from there. A point is all that the next step depends on: the effects' parameters, and where
there is an E the beams that it is seen by, too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.joint_step import limited
from hydrabeam_mpi.fit.state import Estimate, Fit
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.mpi import Comm, bcast_object, gather_objects, together

MEMORY = 5
"""Earlier steps that are looked at: as many slow directions at once. More hardly help, and are of far away."""
RCOND = 1e-6
"""Below this fraction of the largest, differences between steps are those of their rounding and of their limits."""
AHEAD = 2.0
"""Times the proposed step, where those before tell nothing but that it is too short."""

Parts = list[Array]
"""A point, or a step: the parameters of all channels, (Nfreqs, q), and each of the rank group's beams, (n_modes,)."""


class EarlierSteps:
    """The latest points of a fit, and the steps that were proposed there."""

    def __init__(self) -> None:
        self._points: list[Parts] = []
        self._steps: list[Parts] = []

    def forget(self) -> None:
        """Begin anew."""
        self._points, self._steps = [], []

    def add(self, point: Parts, step: Parts) -> None:
        """Remember where the fit is, and the Gauss-Newton step from there."""
        self._points = [*self._points[-MEMORY:], point]
        self._steps = [*self._steps[-MEMORY:], step]

    def better_step(
        self, comm: Comm, in_sigmas: Callable[[Parts], FloatArray], from_saddles: bool = True
    ) -> Parts | None:
        """Return a better step than the latest one; None without earlier ones. Collective: all ranks of ``comm``.

        Parameters
        ----------
        comm : Comm
        in_sigmas : callable
            Gives what counts of a difference on this rank, in standard deviations, (n,). Of what several ranks have
            one alone gives it, as all that ranks give counts.
        from_saddles : bool
            Whether steps lead to where something is highest, and get longer away from a saddle, whose smallest one is
            back there. If not, they lead to the one point where there are none.
        """
        if len(self._points) == 1:
            return None
        moved, changed = _differences(self._points), _differences(self._steps)
        step = self._steps[-1]
        with together(comm):
            mine = np.stack([in_sigmas(one) for one in (*changed, *moved, step)], axis=1)
            # The squares of all rows are those of the triangle.
            triangle = np.linalg.qr(mine, mode="r")
        triangles, weights = gather_objects(comm, triangle), None
        with together(comm):
            if triangles is not None:
                weights = _weights_of_earlier(np.concatenate(triangles), len(changed), from_saddles)
        weights = bcast_object(comm, weights)
        if weights is None:
            return [AHEAD * part for part in step]
        better = list(step)
        for weight, one, two in zip(weights, moved, changed, strict=True):
            better = [part - weight * (m + c) for part, m, c in zip(better, one, two, strict=True)]
        return better


def _differences(each: Sequence[Parts]) -> list[Parts]:
    """Return by how much each differs from the one before."""
    return [[new - old for old, new in zip(before, after, strict=True)] for before, after in pairwise(each)]


def _weights_of_earlier(rows: FloatArray, n: int, from_saddles: bool) -> FloatArray | None:
    """Return how much is taken back of each of ``n`` differences, (n,); None where steps get longer.

    The ``rows``, (n_rows, 2 n + 1), are of the changes of the steps, of the points, and of the latest step.
    """
    changed, moved, step = rows[:, :n], rows[:, n:-1], rows[:, -1]
    weights = np.asarray(np.linalg.lstsq(changed, step, rcond=RCOND)[0], dtype=float)
    better = step - (moved + changed) @ weights
    return weights if better @ step > 0 or not from_saddles else None


def accelerated(
    context: FitContext, at: Estimate, solved_for: Sequence[Posterior], to: Estimate, fit: Fit, earlier: EarlierSteps
) -> Estimate | None:
    """Return where a step leads with what earlier ones tell, each parameter within its limit; None if that is nothing.

    Nor is it anything where channels hang together. Collective: all ranks of the grid.

    Parameters
    ----------
    context : FitContext
    at, to : Estimate
        Where the fit is, E as seen by the beams there, and where the step leads by itself.
    solved_for : sequence of Posterior
        The rank group's beams given the effects ``at``.
    fit : Fit
        What the step tells of the effects.
    earlier : EarlierSteps
        Receives the step.
    """
    values, grid = at.values, context.grid
    if not values.active or context.problem.coupling is not None:
        return None
    here, there = ([one.values.x, *(beam.mean for beam in one.beams if values.adds)] for one in (at, to))
    earlier.add(here, [new - old for old, new in zip(here, there, strict=True)])
    std = np.concatenate([one[:, i.used] for one, i in zip(fit.std, values.active, strict=True)], axis=1)
    per_std = per_sigma(std)

    of_beams = in_sigmas_of(context, solved_for)

    def in_sigmas(difference: Parts) -> FloatArray:
        of_effects = (difference[0] * per_std).ravel() if grid.is_world_root else np.zeros(0)
        return np.concatenate([of_effects, of_beams(difference[1:])])

    wanted = earlier.better_step(grid.world, in_sigmas)
    if wanted is None:
        return None
    change = np.array([limited(values, one) for one in wanted[0]])
    if not values.adds:
        return Estimate(values.at(values.x + change), followed(context, solved_for, fit.beam_response, change))
    pairs = zip(solved_for, at.beams, wanted[1:], strict=True)
    beams = [replace(one, mean=seen_by.mean + further) for one, seen_by, further in pairs]
    return Estimate(values.at(values.x + change), followed(context, beams, fit.beam_response, change - wanted[0]))


def in_sigmas_of(context: FitContext, beams: Sequence[Posterior]) -> Callable[[Parts], FloatArray]:
    """Return what gives differences of the rank group's beams in their standard deviations, (n,), on its root."""

    def in_sigmas(difference: Parts) -> FloatArray:
        counts = [np.zeros(0)]
        if context.grid.is_group_root:
            for beam, mean in zip(beams, difference, strict=False):
                away = beam.factor.conj().T @ mean
                counts += [away.real, away.imag]
        return np.concatenate(counts)

    return in_sigmas


def per_sigma(std: FloatArray) -> FloatArray:
    """Return by what differences are multiplied to be in standard deviations.

    What data hardly constrain does not count: its variance may be no more than rounding errors, of either sign.
    """
    return np.where(std > 0, 1 / np.where(std > 0, std, 1.0), 0.0)


def followed(
    context: FitContext, beams: Sequence[Posterior], response: Sequence[Array], change: FloatArray
) -> tuple[Posterior, ...]:
    """Return the rank group's beams where they belong to parameters that ``change``, (Nfreqs, q)."""
    each = zip(beams, response, context.channels, strict=True)
    return tuple(replace(one, mean=one.mean + by_effects @ change[f]) for one, by_effects, f in each)
