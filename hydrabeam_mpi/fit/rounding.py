"""How far single precision in the design matrix moves the posterior mean, from a few times in double precision.

With A + dA for the rows A that were computed, the mean x moves by -P^-1 A^H N^-1 dA x to first order, where P is the
posterior precision. dA x is the difference between what the mean beam sees in double precision and A x: two real
columns instead of all of them. Rounding errors of different times are independent, as the sources are at other places,
so that the shifts s_t by T of all N times give the standard deviation sqrt(N / T sum_t |s_t|^2) of each coefficient's.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import partial

import numpy as np
from scipy.linalg import cho_solve

from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.fit.accumulate import seen_by
from hydrabeam_mpi.fit.rows import Rows
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.mpi import ProcessGrid, allreduce_sum
from hydrabeam_mpi.setup.problem import Problem

MOST_SHIFT = 1e-2
"""Of a coefficient, in its posterior std: too small to be seen in anything that is told of a posterior."""
TIMES_IN_DOUBLE = 2
"""Enough to tell the size of rounding errors, much the same at all times; each takes a fifth of a time's design."""


class Rounding:
    """The rounding errors of a rank's rows at a few of all times.

    Parameters
    ----------
    problem : Problem
    rows : Rows
        The rank's training rows.
    """

    def __init__(self, problem: Problem, rows: Rows) -> None:
        self.problem, self.rows = problem, rows
        times = problem.train.times
        count = min(TIMES_IN_DOUBLE, len(times))
        self.n_times = len(times)
        self.sampled = times[(2 * np.arange(count) + 1) * len(times) // (2 * count)]
        self._designs: dict[int, Array] = {}

    def watch(self, by_time: Iterable[Array]) -> Iterator[Array]:
        """Pass on the designs of the rank's times, and keep those of the few."""
        for time, design in zip(self.rows.tile.times.tolist(), by_time, strict=True):
            if time in self.sampled:
                self._designs[time] = design
            yield design

    def shifts(self, grid: ProcessGrid, posteriors: Sequence[Posterior]) -> FloatArray:
        """Return two standard deviations of the shift of the coefficient that moves most, in its std, (Nfreqs,).

        Collective: all ranks of `grid.group`; those other than its root are told zero.
        """
        n_modes = self.problem.basis.n_modes
        pulls = np.zeros((len(posteriors), len(self.sampled), n_modes), dtype=posteriors[0].factor.dtype)
        weights = self.rows.compressed()[1]
        model = self.problem.forward_model(self.rows.groups)
        for time, design in self._designs.items():
            t, sample = list(self.rows.tile.times).index(time), list(self.sampled).index(time)
            beams = [partial(self.problem.basis.synthesize, one.mean) for one in posteriors]
            exact = model.visibilities(beams, np.array([time]))[:, 0]
            for f, posterior in enumerate(posteriors):
                error = weights[f, t] * (exact[f] - seen_by(design[f], posterior.mean))
                pulls[f, sample] = _pull(design[f], error)
        allreduce_sum(grid.group, pulls)
        worst = np.zeros(len(posteriors))
        for f, posterior in enumerate(posteriors if grid.is_group_root else ()):
            moved = cho_solve((posterior.factor, True), pulls[f].T, check_finite=False)
            worst[f] = np.max(np.linalg.norm(moved, axis=1) / posterior.std)
        return 2 * worst * np.sqrt(self.n_times / max(len(self.sampled), 1))


def _pull(design: Array, weighted: Array) -> Array:
    """Return P dx for what data are weighted with, (n,): A^H r, and of real unknowns 2 Re A^H r."""
    if np.iscomplexobj(design):
        return np.asarray(design.conj().T @ weighted)
    return np.asarray(2 * (design[0].T @ weighted.real + design[1].T @ weighted.imag))
