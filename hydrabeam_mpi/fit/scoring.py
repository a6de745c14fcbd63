"""The maximum of a likelihood within bounds, by Fisher scoring: Newton's steps with the expected information."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from hydrabeam_mpi.data.observation import FloatArray

ENOUGH = 0.1
"""A step that promises less, in nats, is the last: no decision hangs on so little."""
LONGEST, SHORTEST = 2.0, 1e-3
"""Most that a number changes in a step, in which a likelihood of logarithms is not a parabola any more; and the length
at which steps that were too long are not shortened any more."""
POOR, GOOD = 0.25, 0.75
"""Shares of its promise: a step that keeps less than the one is followed by a shorter one, more than the other by a
longer one (Conn, Gould and Toint 2000, Trust-Region Methods) ..."""
LONGER, SHORTER = 2.0, 0.25
"""... by these factors."""


@dataclass(frozen=True)
class Told:
    """What is told of numbers: ln of the likelihood, its gradient, (n,), and the expected information, (n, n)."""

    value: float
    slope: FloatArray
    information: FloatArray

    def __add__(self, other: Told) -> Told:
        """Return what both tell together."""
        information = self.information + other.information
        return Told(self.value + other.value, self.slope + other.slope, information)


def highest(tell: Callable[[FloatArray], Told], begin: FloatArray, bounds: FloatArray) -> tuple[FloatArray, float]:
    """Return where a likelihood is largest, (n,), and its value there.

    Parameters
    ----------
    tell : callable
        What is told at given numbers.
    begin : ndarray, (n,)
        Where to begin; what is out of bounds is taken at these.
    bounds : ndarray, (2, n)
        Least and largest numbers; where both are the same a number is not free.
    """
    at, reach = np.clip(begin, *bounds), LONGEST
    here = tell(at)
    while reach > SHORTEST:
        low, high = np.maximum(bounds[0] - at, -reach), np.minimum(bounds[1] - at, reach)
        step = _step(here, low, high)
        promised = step @ here.slope - 0.5 * step @ here.information @ step
        if promised < ENOUGH:
            break
        there = tell(at + step)
        kept = (there.value - here.value) / promised
        factor = SHORTER if kept < POOR else LONGER if kept > GOOD else 1.0
        reach = min(factor * float(np.abs(step).max()), LONGEST)
        if kept > 0:
            at, here = at + step, there
    return at, here.value


def _step(here: Told, low: FloatArray, high: FloatArray) -> FloatArray:
    """Return the step, (n,), to the top of the parabola that is told of, within bounds."""
    free, step = high > low, np.zeros_like(low)
    factor = np.linalg.cholesky(here.information[np.ix_(free, free)])
    pull = np.linalg.solve(factor, here.slope[free])
    step[free] = lsq_linear(factor.T, pull, (low[free], high[free]), method="bvls").x
    return np.clip(step, low, high)
