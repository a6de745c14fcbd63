"""Whether an effect is the same in all parts of the data: random effects, compared by their evidence.

An effect that is what it says has the same parameters at all times and on all baselines. In data with a fault that the
loop has no name for, effects that are not there fit in each part whatever is wrong in it, and a Gaussian likelihood,
which takes all that is not in the model for noise of the stated size, cannot tell the difference. So let parameters be

    x_k = mu + delta_k,   delta_k ~ N(0, tau^2 T)

in part k of the data, T the variances of the effect's prior and tau one unknown spread. Of the evidence with a common
part, mu ~ N(0, T), and of that without, mu = 0, each at the spread that is the best for it, the ratio is the Bayes
factor for a common part. Parts are blocks of times, and besides folds of groups of baselines, and blocks of channels
where all channels have the same parameters: what varies in time alone is the same in all groups and channels, and the
other way round, so that each is asked by itself.

Where parameters are told by one part only both hypotheses are the same, and with few or uncertain parts nearly so: then
the data cannot decide, whatever they say. That is known beforehand, from the Bayes factor that is expected of these
data if the effect is the same in all parts.

Where more is left of the data than noise, that differs between parts as well, and so do the parameters of a true effect
beside it. Then the variance of the data counts as unknown up to a factor, see `fit.error_scale`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import minimize_scalar

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.eigen import eigen
from hydrabeam_mpi.inference.likelihood import RANK_RTOL, Likelihood
from hydrabeam_mpi.inference.matrices import cholesky_lower

SPREADS: FloatArray = np.exp(np.arange(np.log(1e-5), np.log(1e3)))
"""Spreads tried, in units of the prior's width: from far below what data tell to far above the parameters. The best is
then looked for between its neighbours."""
FLAT_NATS = 0.01
"""A spread that adds less than this to ln evidence counts as none: its value would be rounding."""


@dataclass(frozen=True)
class Constancy:
    """Whether an effect has the same parameters in all parts of the data.

    Attributes
    ----------
    between : str
        Which parts: "times", "baselines", "channels", or the name of those that are affected and the others.
    log_bayes_factor : float
        Natural logarithm, for a common part of the parameters against none.
    expected : float
        What it is on average for parameters as they have been found, if they are the same in all parts.
    spread : float
        By how much parameters differ between parts, in units of their common part; both are rms values.
    expected_by_noise : float
        What would be expected if nothing but noise of the stated size were left of the data.
    """

    between: str
    log_bayes_factor: float
    expected: float
    spread: float
    expected_by_noise: float


@dataclass(frozen=True)
class Spectrum:
    """A likelihood along the eigenvectors of its information, parameters in units of their prior's width.

    Attributes
    ----------
    values, scores : ndarray, (n,)
        Eigenvalues, and the score along their vectors.
    noise : ndarray, (n,)
        Variance of the score by noise that is not in it yet.
    common : ndarray, (n, q)
        Of parameters that are the same in all parts along the eigenvectors.
    """

    values: FloatArray
    scores: FloatArray
    noise: FloatArray
    common: FloatArray

    @classmethod
    def of(cls, information: FloatArray, score: FloatArray, q: int) -> Spectrum:
        """Decompose the information of the parameters in all parts, (Kq, Kq)."""
        values, vectors = eigen(information)
        told = values > RANK_RTOL * max(values[-1], 0.0)
        values, vectors = values[told], vectors[:, told]
        common = vectors.reshape(len(vectors) // q, q, len(values)).sum(axis=0).T
        return cls(values, vectors.T @ score, np.zeros(len(values)), common)

    def at_variance(self, factor: float) -> Spectrum:
        """Return what the same data say if their variance is ``factor`` times as large."""
        return replace(self, values=self.values / factor, scores=self.scores / factor, noise=self.noise / factor)

    def of_the_same(self) -> Spectrum:
        """Return what is expected of data in which the common part is as it is here, and nothing differs."""
        return Spectrum(self.values, self.values * (self.common @ self.common_part(0.0)), self.values, self.common)

    def common_part(self, spread: float) -> FloatArray:
        """Return the posterior mean of the common part, (q,)."""
        factor, shrunk = self._of_common(spread)
        white = solve_triangular(factor, shrunk @ self.scores, lower=True)
        return np.asarray(solve_triangular(factor, white, lower=True, trans="T"))

    def _of_common(self, spread: float) -> tuple[FloatArray, FloatArray]:
        """Return the factor of the posterior precision of the common part, and what makes its score of the scores."""
        grown = 1 + spread**2 * self.values
        root = np.sqrt(self.values / grown)[:, np.newaxis] * self.common
        # A product with itself takes half as long as another one.
        return cholesky_lower(np.eye(root.shape[1]) + root.T @ root), self.common.T / grown

    def without_common(self, spread: float) -> float:
        """Return ln evidence without a common part, over that of no effect."""
        grown = 1 + spread**2 * self.values
        return 0.5 * float(np.sum(spread**2 * (self.scores**2 + self.noise) / grown - np.log(grown)))

    def with_common(self, spread: float) -> float:
        """Return ln evidence with a common part, over that of no effect."""
        factor, shrunk = self._of_common(spread)
        told = (shrunk @ self.scores)[:, np.newaxis]
        if self.noise.any():
            told = np.hstack([told, shrunk * np.sqrt(self.noise)])
        quadratic = float(np.sum(solve_triangular(factor, told, lower=True) ** 2))
        return self.without_common(spread) + 0.5 * quadratic - float(np.sum(np.log(np.diag(factor))))


def compare(
    blocks: Sequence[Likelihood], std: FloatArray, between: str, price: float, variances: Sequence[float]
) -> Constancy:
    """Compare parameters with a common part in all parts with such as have none.

    Parameters
    ----------
    blocks : list of Likelihood
        Independent of each other, such as channels: of the parameters in all parts, (Kq,), around zero.
    std : ndarray, (q,)
        Widths of the parameters' prior.
    between : str
        What the parts are.
    price : float
        Nats that the choice of the prior costs, whether it is that of a common part or of what differs.
    variances : sequence of float
        Of the data of each block, in units of the stated one.
    """
    by_noise = []
    for one in blocks:
        scale = np.tile(std, len(one.score) // len(std))
        by_noise.append(Spectrum.of(scale[:, np.newaxis] * one.information * scale, scale * one.score, len(std)))
    spectra = [one.at_variance(factor) for one, factor in zip(by_noise, variances, strict=True)]
    found, spread = _log_bayes_factor(spectra, price)
    expected, expected_by_noise = (
        _log_bayes_factor([one.of_the_same() for one in of], price)[0] for of in (spectra, by_noise)
    )
    common = np.concatenate([one.common_part(spread) for one in spectra])
    relative = spread / max(float(np.sqrt(np.mean(common**2))), 1e-300)
    return Constancy(between, found, expected, relative, expected_by_noise)


def _log_bayes_factor(spectra: Sequence[Spectrum], price: float) -> tuple[float, float]:
    """Return ln of the Bayes factor for a common part, and the best spread with it."""
    with_common, spread = _highest(lambda spread: sum(one.with_common(spread) for one in spectra))
    without, _ = _highest(lambda spread: sum(one.without_common(spread) for one in spectra))
    # Without a common part and without a spread there is no effect, which costs nothing.
    return with_common - price - max(without - price, 0.0), spread


def _highest(log_evidence: Callable[[float], float]) -> tuple[float, float]:
    """Return the highest evidence over spreads, and the spread; zero where it is the best."""
    tried = [log_evidence(spread) for spread in SPREADS]
    middle = float(np.log(SPREADS[int(np.argmax(tried))]))
    best = minimize_scalar(
        lambda ln: -log_evidence(float(np.exp(ln))),
        bounds=(middle - 1, middle + 1),
        method="bounded",
        options={"xatol": 0.02},
    )
    none = log_evidence(0.0)
    return (none, 0.0) if none >= -best.fun - FLAT_NATS else (float(-best.fun), float(np.exp(best.x)))
