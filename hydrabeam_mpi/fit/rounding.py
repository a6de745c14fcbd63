"""How far single precision in the design matrix moves the posterior mean, from a few times in double precision.

With A + dA for the rows A that were computed, the mean x moves by -P^-1 A^H N^-1 dA x to first order, where P is the
posterior precision. dA x is the difference between what the mean beam sees in double precision and A x: two real
columns instead of all of them. Rounding errors of different times are independent, as the sources are at other places,
so that the shifts s_t by T of all N times give the standard deviation sqrt(N / T sum_t |s_t|^2) of each coefficient's.
Where beams hang together over frequency, each is moved by the errors of all channels, which add up as far as these have
one mode in common: by as many times as that has channels, the largest eigenvalue of the covariance over channels.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from scipy.linalg import cho_solve

from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.fit.accumulate import seen_by
from hydrabeam_mpi.fit.rows import Rows
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.mpi import Comm, ProcessGrid, allreduce_sum
from hydrabeam_mpi.setup.problem import Problem

MOST_SHIFT = 1e-2
"""Of a coefficient, in its posterior std: too small to be seen in anything that is told of a posterior."""
TIMES_IN_DOUBLE = 6
"""Enough to tell the size of rounding errors, much the same at all times, of the coefficient that moves most: of fewer
the largest of a thousand is too large by chance. Each takes a fifth of a time's design."""


class Rounding:
    """The rounding errors of a rank's rows at a few of all times.

    Collective: all ranks of ``group``.

    Parameters
    ----------
    group : mpi4py.MPI.Comm
        Those that share the channels' rows.
    problem : Problem
    rows : Rows
        The rank's training rows.
    """

    def __init__(self, group: Comm, problem: Problem, rows: Rows) -> None:
        self.problem, self.rows = problem, rows
        self._weights = rows.compressed()[1]
        times = problem.train.times
        counts = np.zeros((len(self._weights), len(times)))
        counts[:, np.searchsorted(times, rows.tile.times)] = np.count_nonzero(self._weights, axis=2)
        allreduce_sum(group, counts)
        has_data = counts > 0
        # Times at which all is flagged tell nothing: of those at which most channels have data.
        of_channels = has_data.sum(axis=0)
        full = np.flatnonzero(of_channels == of_channels.max(initial=0))
        count = min(TIMES_IN_DOUBLE, len(full))
        chosen = full[(2 * np.arange(count) + 1) * len(full) // (2 * max(count, 1))]
        self.sampled = times[chosen]
        self._scale = np.sqrt(has_data.sum(axis=1) / np.maximum(has_data[:, chosen].sum(axis=1), 1))
        self._designs: dict[int, Array] = {}

    def watch(self, t: int, design: Array) -> None:
        """Keep the design of the rank's time number ``t`` if it is of the few."""
        time = int(self.rows.tile.times[t])
        if time in self.sampled:
            self._designs[time] = design

    def shifts(self, grid: ProcessGrid, posteriors: Sequence[Posterior]) -> FloatArray:
        """Return two standard deviations of the shift of the coefficient that moves most, in its std, (Nfreqs,).

        Collective: all ranks of `grid.group`; those other than its root are told zero.
        """
        n_modes = self.problem.basis.n_modes
        pulls = np.zeros((len(posteriors), len(self.sampled), n_modes), dtype=posteriors[0].factor.dtype)
        model = self.problem.forward_model(self.rows.groups)
        for time, design in self._designs.items():
            t, sample = list(self.rows.tile.times).index(time), list(self.sampled).index(time)
            beams = [partial(self.problem.basis.synthesize, one.mean) for one in posteriors]
            exact = model.visibilities(beams, np.array([time]))[:, 0]
            for f, posterior in enumerate(posteriors):
                error = self._weights[f, t] * (exact[f] - seen_by(design[f], posterior.mean))
                pulls[f, sample] = _pull(design[f], error)
        allreduce_sum(grid.group, pulls)
        worst = np.zeros(len(posteriors))
        for f, posterior in enumerate(posteriors if grid.is_group_root else ()):
            moved = cho_solve((posterior.factor, True), pulls[f].T, check_finite=False)
            worst[f] = np.max(np.linalg.norm(moved, axis=1) / posterior.std)
        return 2 * worst * self._scale * self._in_common()

    def _in_common(self) -> float:
        """Return how many channels' errors add up in a beam."""
        coupling = self.problem.coupling
        if coupling is None:
            return 1.0
        return max(float(np.sum(modes**2, axis=0).max()) for modes in coupling.candidates)


def _pull(design: Array, weighted: Array) -> Array:
    """Return P dx for what data are weighted with, (n,): A^H r, and of real unknowns 2 Re A^H r."""
    if np.iscomplexobj(design):
        return np.asarray(design.conj().T @ weighted)
    return np.asarray(2 * (design[0].T @ weighted.real + design[1].T @ weighted.imag))
