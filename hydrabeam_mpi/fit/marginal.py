"""The sums over rows with one block marginalised (the Schur complement): what the data say of the others."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import solve_triangular

from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.fit.equations import NormalEquations
from hydrabeam_mpi.inference.likelihood import Likelihood
from hydrabeam_mpi.inference.posterior import Posterior


class Marginal:
    """Normal equations with a block marginalised; what it takes of the others is worked out once for each.

    Parameters
    ----------
    sums : NormalEquations
        Their data are residuals at the ``posterior``'s mean.
    without : str
        Block to marginalise.
    posterior : Posterior
        Its posterior given the others, of which the factor counts.
    pull : ndarray, (n,), optional
        Towards where it is likeliest given the others, its precision times how far that is; none where it is there.
    """

    def __init__(self, sums: NormalEquations, without: str, posterior: Posterior, pull: Array | None = None) -> None:
        self.sums, self._without, self._posterior, self._pull = sums, without, posterior, pull
        self._halves: dict[str, FloatArray] = {}
        self._taken: dict[tuple[str, str], FloatArray] = {}

    def likelihood(self, names: Sequence[str]) -> Likelihood:
        """Return what the data say of some blocks with real unknowns."""
        known = self.sums.likelihood_alone(names)
        lines = [np.concatenate([self._taken_of(one, two) for two in names], axis=1) for one in names]
        taken = np.concatenate(lines) if lines else known.signal
        score = known.score
        if self._pull is not None and names:
            white = in_parts(solve_triangular(self._posterior.factor, self._pull, lower=True, check_finite=False))
            score = score - 2 * np.concatenate([self._half(name).T @ white for name in names])
        return Likelihood(known.signal - taken, score, known.signal)

    def response(self, names: Sequence[str]) -> Array:
        """Return by how much the best values of the block move with each unknown of others, (n, q)."""
        posterior = self._posterior
        half = np.concatenate([self._half(name) for name in names], axis=1) if names else self._across([])
        if names and posterior.is_complex:
            real, imag = np.split(half, 2)
            half = real + 1j * imag
        kappa = 1.0 if posterior.is_complex else 2.0
        return np.asarray(-kappa * solve_triangular(posterior.factor, half, lower=True, trans="C", check_finite=False))

    def _across(self, names: Sequence[str]) -> Array:
        return self.sums.gather([self._without], names)

    def _half(self, name: str) -> FloatArray:
        """Return L^-1 G of a block in parts, with L the factor of the marginalised one's precision."""
        if name not in self._halves:
            across = self._across([name])
            half = solve_triangular(self._posterior.factor, across, lower=True, check_finite=False)
            self._halves[name] = in_parts(half)
        return self._halves[name]

    def _taken_of(self, one: str, two: str) -> FloatArray:
        """Return how much information on two blocks is lost."""
        if (two, one) in self._taken:
            return self._taken[two, one].T
        if (one, two) not in self._taken:
            kappa = 2.0 if self._posterior.is_complex else 4.0
            # Of a matrix with itself NumPy works out one triangle.
            self._taken[one, two] = kappa * (self._half(one).T @ self._half(two))
        return self._taken[one, two]


def in_parts(half: Array) -> FloatArray:
    """Return real parts above imaginary ones, with which the real part of a product is a real product."""
    return np.concatenate([half.real, half.imag]) if np.iscomplexobj(half) else half
