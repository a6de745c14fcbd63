"""The likelihood of some real parameters: a Gaussian, up to its height.

    ln L(x) = u.x - x^T K x / 2 + const,

with all that is not x (the beam, other parameters) set to values or marginalised.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from hydrabeam_mpi.data.observation import FloatArray, IntArray
from hydrabeam_mpi.eigen import eigen
from hydrabeam_mpi.inference.gaussian import Block, Gaussian

RANK_RTOL = 1e-9
"""Eigenvalues of K below this times the largest are rounding errors, and count as zero."""

ROUNDING = 1e-13
"""Information relative to that with the beam known, up to which it may be what sums over rows lose by rounding."""


@dataclass(frozen=True)
class Likelihood:
    """What one channel, or all together, say of some parameters.

    Attributes
    ----------
    information : ndarray, (q, q)
        K: the Fisher information with the beam and all else that is free marginalised.
    score : ndarray, (q,)
        u, the gradient of ln L at x = 0.
    signal : ndarray, (q, q)
        2 Re S^H N^-1 S: the information if all else were known.
    """

    information: FloatArray
    score: FloatArray
    signal: FloatArray

    def __add__(self, other: Likelihood) -> Likelihood:
        return Likelihood(self.information + other.information, self.score + other.score, self.signal + other.signal)

    def first(self, n: int) -> Likelihood:
        """Return the likelihood of the first ``n`` parameters, with the others at zero."""
        return Likelihood(self.information[:n, :n], self.score[:n], self.signal[:n, :n])

    def most_gain(self) -> float:
        """Return ln L where that is largest, over ln L at x = 0; rounding may make it more, not less.

        Parameters have units of their own, so that each counts by what it would be if all else were known.
        """
        present = np.sqrt(np.maximum(np.diag(self.signal), 0.0))
        seen = present > 0
        scale = np.divide(1.0, present, out=np.zeros_like(present), where=seen)
        information, score = scale[:, np.newaxis] * self.information * scale, scale * self.score
        least = ROUNDING * max(float(np.max(np.diag(information), initial=0.0)), np.finfo(float).tiny)
        try:
            return 0.5 * float(score @ cho_solve(cho_factor(information + least * np.eye(len(score))), score))
        except np.linalg.LinAlgError:
            values, vectors = eigen(information)
            told = values > ROUNDING * max(values.max(initial=0.0), 0.0)
            return 0.5 * float(np.sum((vectors[:, told].T @ score) ** 2 / values[told]))

    def marginalised(self, which: IntArray, precision: FloatArray) -> Likelihood:
        """Return the likelihood of the others, with some parameters marginalised that have a prior around zero.

        Parameters
        ----------
        which : ndarray of int, (p,)
            The parameters to marginalise.
        precision : ndarray, (p, p)
            Of their prior.
        """
        if not len(which):
            return self
        rest = np.delete(np.arange(len(self.score)), which)
        order = np.concatenate([which, rest])
        posterior = self.information[np.ix_(order, order)]
        posterior[: len(which), : len(which)] += precision
        blocks = Block("which", len(which)), Block("rest", len(rest))
        left = Gaussian(blocks, posterior, self.score[order], None).marginalise(["which"])
        return Likelihood(left.precision, left.source, self.signal[np.ix_(rest, rest)])

    def freed(self, combinations: FloatArray) -> Likelihood:
        """Return the likelihood with combinations of the parameters, (n, q), marginalised without a prior.

        It no longer depends on these. Combinations that the data do not constrain at all change nothing.
        """
        present = np.sqrt(combinations**2 @ np.maximum(np.diag(self.signal), 0.0))
        combinations = combinations[present > 0] / present[present > 0, np.newaxis]
        across = self.information @ combinations.T
        values, vectors = eigen(combinations @ across)
        told = values > max(ROUNDING, RANK_RTOL * values.max(initial=0.0))
        inverse = (vectors[:, told] / values[told]) @ vectors[:, told].T
        information = self.information - across @ inverse @ across.T
        return Likelihood(information, self.score - across @ inverse @ (combinations @ self.score), self.signal)
