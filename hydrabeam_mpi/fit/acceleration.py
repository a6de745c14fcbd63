"""Steps that learn from those before: Anderson acceleration (Anderson 1965; Walker and Ni 2011).

A Gauss-Newton step leaves out how the columns of the effects change with the parameters, times the residual. Where the
residual is large, as it is while something else is missing, steps are then several times too short or too long along
some directions, and go on for dozens of times. How steps have changed from point to point tells these directions: from
the points so far that combination is taken whose step is the smallest, and that step from there.
"""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray

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

    def accelerated(self, point: FloatArray, step: FloatArray, std: FloatArray) -> FloatArray:
        """Return a better step than the one that is proposed; without earlier ones that one.

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
            return step
        moved, changed = (np.diff(one, axis=0) for one in (self._points, self._steps))
        in_sigmas = (changed / std).reshape(len(changed), -1).T
        weights = np.linalg.lstsq(in_sigmas, (step / std).ravel(), rcond=RCOND)[0]
        better = np.asarray(step - np.tensordot(weights, moved + changed, axes=1))
        # Away from a saddle steps get longer; the smallest one is back there.
        return better if np.sum(better * step / std**2) > 0 else AHEAD * step
