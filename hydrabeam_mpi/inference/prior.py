"""Gaussian priors on coefficients, real or complex (HDBI II, eq. 10)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve, solve_triangular

from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.data.partition import spans
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.inference.mode_widths import ModeSizes, PriorWidths


class Prior(Protocol):
    """A Gaussian in the coefficients, possibly flat."""

    @property
    def mean(self) -> Array:
        """Its centre, (n,)."""

    @property
    def log_det_precision(self) -> float | None:
        """ln|Sigma^-1|, or None where the prior is flat."""

    def add_precision(self, matrix: Array) -> None:
        """Add Sigma^-1 to ``matrix``, (n, n), in place."""

    def precision_times(self, vector: Array) -> Array:
        """Return Sigma^-1 ``vector``, (n,)."""

    def std(self) -> FloatArray:
        """Return the standard deviation of each coefficient; infinite where flat, (n,)."""


@dataclass(frozen=True)
class FlatPrior:
    """No prior: the posterior is the likelihood. ``mean`` is only a point of reference."""

    mean: Array

    @property
    def log_det_precision(self) -> float | None:
        """None: a flat prior has no evidence."""
        return None

    def add_precision(self, matrix: Array) -> None:
        """Add nothing to the (n, n) matrix."""

    def precision_times(self, vector: Array) -> Array:
        """Return zeros, (n,)."""
        return np.zeros_like(vector)

    def std(self) -> FloatArray:
        """Return infinities, (n,)."""
        return np.full(len(self.mean), np.inf)


@dataclass(frozen=True)
class DiagonalPrior:
    """Independent coefficients with standard deviations ``sigma`` (E|x - mean|^2 = sigma^2), and some that go together.

    Attributes
    ----------
    mean : ndarray, (n,)
    sigma : ndarray, (n,)
    sizes : ModeSizes, optional
        What these may be adapted by; None where they are as they are.
    shape : ndarray, (n, k), optional
        What the coefficients have beside that of k numbers of variance one, which move many together: the covariance
        is diag(sigma^2) + V V^H.
    """

    mean: Array
    sigma: FloatArray
    sizes: ModeSizes | None = None
    shape: Array | None = None

    @classmethod
    def of(cls, mean: Array, sizes: ModeSizes, widths: PriorWidths, shape: Array | None = None) -> DiagonalPrior:
        """Return the prior about a mean, (n,), whose widths follow from sizes."""
        return cls(mean, np.hypot(*sizes.widths(widths)), sizes, shape)

    @cached_property
    def _of_shape(self) -> tuple[Array, Array, float]:
        """sigma^-2 V, (n, k), the same times (1 + V^H sigma^-2 V)^-1, and ln|1 + V^H sigma^-2 V|."""
        columns = np.zeros((len(self.mean), 0)) if self.shape is None else self.shape
        pulled = columns / self.sigma[:, np.newaxis] ** 2
        inner = np.eye(columns.shape[1]) + columns.conj().T @ pulled
        return pulled, np.linalg.solve(inner, pulled.conj().T).conj().T, float(np.linalg.slogdet(inner)[1])

    @property
    def log_det_precision(self) -> float | None:
        """ln|Sigma^-1|."""
        return float(-2 * np.sum(np.log(self.sigma))) - self._of_shape[2]

    def add_precision(self, matrix: Array) -> None:
        """Add Sigma^-1 to the (n, n) matrix."""
        matrix[np.diag_indices_from(matrix)] += self.sigma**-2.0
        if self.shape is not None:
            pulled, solved, _ = self._of_shape
            matrix -= pulled @ solved.conj().T

    def precision_times(self, vector: Array) -> Array:
        """Return Sigma^-1 ``vector``, (n,)."""
        pulled, solved, _ = self._of_shape
        return (vector.T / self.sigma**2).T - solved @ (pulled.conj().T @ vector)

    def std(self) -> FloatArray:
        """Return the standard deviations, (n,)."""
        if self.shape is None:
            return self.sigma
        return np.sqrt(self.sigma**2 + np.sum(np.abs(self.shape) ** 2, axis=1))

    def adapted(self, widths: PriorWidths) -> DiagonalPrior:
        """Return the same with other widths.

        Raises
        ------
        ValueError
            If there is nothing from which they follow.
        """
        if self.sizes is None:
            raise ValueError("the widths of this prior cannot be adapted")
        return self.of(self.mean, self.sizes, widths, self.shape)


class CovariancePrior:
    """A full covariance, such as that of an ensemble of perturbed beams.

    Raises
    ------
    InputError
        If the covariance is not positive definite.
    """

    def __init__(self, mean: Array, covariance: Array) -> None:
        self.mean = mean
        try:
            self._factor = cho_factor(covariance, lower=True)
        except LinAlgError as error:
            raise InputError(
                "the prior covariance is not positive definite",
                field="[prior] file",
                remedy="add to its diagonal, or draw more beams than there are modes",
            ) from error
        self._std = np.sqrt(np.diag(covariance).real)

    @property
    def log_det_precision(self) -> float | None:
        """ln|Sigma^-1|."""
        return float(-2 * np.sum(np.log(np.diag(self._factor[0]).real)))

    def add_precision(self, matrix: Array) -> None:
        """Add the inverse covariance to the (n, n) matrix."""
        matrix += cho_solve(self._factor, np.eye(len(self.mean), dtype=matrix.dtype))

    def precision_times(self, vector: Array) -> Array:
        """Return the inverse covariance times ``vector``, (n,)."""
        return cho_solve(self._factor, vector)

    def std(self) -> FloatArray:
        """Return the square root of the diagonal, (n,)."""
        return self._std


@dataclass(frozen=True)
class FactoredPrior:
    """A Gaussian known by the lower factor L of its precision, L L^H = Sigma^-1, such as an earlier posterior.

    The factor is (n, n).
    """

    mean: Array
    factor: Array

    @property
    def log_det_precision(self) -> float | None:
        """ln|Sigma^-1|."""
        return float(2 * np.sum(np.log(np.diag(self.factor).real)))

    def add_precision(self, matrix: Array) -> None:
        """Add L L^H to the (n, n) matrix."""
        matrix += self.factor @ self.factor.conj().T

    def precision_times(self, vector: Array) -> Array:
        """Return L L^H ``vector``, (n, ...)."""
        return self.factor @ (self.factor.conj().T @ vector)

    def std(self) -> FloatArray:
        """Return the root of the diagonal of the covariance L^-H L^-1, (n,)."""
        half = solve_triangular(self.factor, np.eye(len(self.mean)), lower=True, check_finite=False)
        return np.sqrt(np.sum(np.abs(half) ** 2, axis=0))


@dataclass(frozen=True)
class BlockPrior:
    """The priors of several blocks of coefficients, side by side and independent of each other."""

    priors: tuple[Prior, ...]

    @property
    def mean(self) -> Array:
        """Their centres, (n,)."""
        return np.concatenate([prior.mean for prior in self.priors])

    @property
    def log_det_precision(self) -> float | None:
        """ln|Sigma^-1|, or None where one of them is flat."""
        parts = [prior.log_det_precision for prior in self.priors]
        known = [part for part in parts if part is not None]
        return sum(known) if len(known) == len(parts) else None

    def add_precision(self, matrix: Array) -> None:
        """Add Sigma^-1 to the (n, n) matrix."""
        for prior, span in zip(self.priors, self._spans, strict=True):
            prior.add_precision(matrix[span, span])

    def precision_times(self, vector: Array) -> Array:
        """Return Sigma^-1 ``vector``, (n,)."""
        parts = zip(self.priors, self._spans, strict=True)
        return np.concatenate([prior.precision_times(vector[span]) for prior, span in parts])

    def std(self) -> FloatArray:
        """Return the standard deviations, (n,)."""
        return np.concatenate([prior.std() for prior in self.priors])

    @property
    def _spans(self) -> list[slice]:
        return spans(len(prior.mean) for prior in self.priors)


@dataclass(frozen=True)
class ChannelPrior:
    """The prior of real parameters over channels: a Gaussian in (channel, parameter).

    Two special cases of it are channels that know nothing of each other, and channels that are all alike.

    Attributes
    ----------
    priors : tuple of Prior
        Of independent channels: one a channel, or a single one, which is that of every channel. A single one where
        channels are alike or coupled.
    shared : bool
        Whether channels share one set of parameters, which have the same values in all of them.
    n_coupled : int
        Number of channels whose parameters the single prior is about, side by side, (n_coupled x n,), such as those
        that change smoothly with frequency; zero where channels are independent or alike.
    """

    priors: tuple[Prior, ...]
    shared: bool = False
    n_coupled: int = 0

    def __post_init__(self) -> None:
        if (self.shared or self.n_coupled) and len(self.priors) > 1:
            raise ValueError("parameters that channels share or couple have one prior")
        if self.shared and self.n_coupled:
            raise ValueError("parameters that channels share are not coupled besides")

    def of(self, channel: int) -> Prior:
        """Return the prior in one channel, whatever the others are."""
        return self._marginals[channel if len(self._marginals) > 1 else 0]

    @cached_property
    def _marginals(self) -> tuple[Prior, ...]:
        if not self.n_coupled:
            return self.priors
        (joint,) = self.priors
        means = joint.mean.reshape(self.n_coupled, -1)
        covariance = np.linalg.inv(precision_of(joint)).reshape(2 * means.shape)
        return tuple(CovariancePrior(mean, covariance[f, :, f]) for f, mean in enumerate(means))

    def pieces(self, n_freqs: int) -> list[tuple[range, Prior]]:
        """Return the channels whose parameters, side by side, have a prior together, and that prior.

        Parameters that channels share are those of the first.
        """
        if self.shared or self.n_coupled:
            return [(range(self.n_coupled or 1), self.priors[0])]
        return [(range(f, f + 1), self.of(f)) for f in range(n_freqs)]

    def log_density(self, x: FloatArray) -> float:
        """Return ln of the density of the parameters, (Nfreqs, n), up to a constant."""
        away = [(x[channels].reshape(-1) - prior.mean, prior) for channels, prior in self.pieces(len(x))]
        return -0.5 * sum(float(one @ prior.precision_times(one)) for one, prior in away)

    def score(self, x: FloatArray) -> FloatArray:
        """Return the gradient of ln of the density at ``x``, both (Nfreqs, n); of shared ones the same in each."""
        pulls = [
            prior.precision_times(prior.mean - x[some].reshape(-1)).reshape(len(some), -1 if x.size else 0)
            for some, prior in self.pieces(len(x))
        ]
        return np.broadcast_to(np.concatenate(pulls), x.shape)


def precision_of(prior: Prior) -> FloatArray:
    """Return Sigma^-1 of real parameters, (n, n)."""
    matrix = np.zeros((len(prior.mean), len(prior.mean)))
    prior.add_precision(matrix)
    return matrix
