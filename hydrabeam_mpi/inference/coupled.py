"""Beams of all channels that hang together over frequency: one Gaussian, solved for in modes along frequency.

The coefficients b_f of channel f, of prior mean m_f and widths s_f, are

    b_f = m_f + s_f a_f,        a_f = sum_m U_fm c_m,        c_m ~ N(0, 1),

so that a coefficient has the covariance K = U U^T over channels, in units of its widths. What data say of a channel,

    ln p(d_f | b_f) = l_f + (2 Re a_f^H h_f - a_f^H J_f a_f) / kappa,

with kappa as in `hydrabeam_mpi.inference.gaussian`, is independent of the other channels, so that the posterior
precision of the c is (in blocks, one a pair of modes; n x n each)

    P_mm' = delta_mm' + sum_f U_fm U_fm' J_f,        with the source sum_f U_fm h_f.

It draws by the constrained realisation (HDBI II, appendix A): P x = source + noise, with noise of covariance P. Where
U^T U is diagonal, of eigenvalues l_m no greater than the number N of channels, P is the sum over channels of
U_f U_f^T times (1/N + J_f), of which each channel draws its part by its own Cholesky factor, and of 1 - l_m / N.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.inference.gaussian import Block, Gaussian
from hydrabeam_mpi.inference.matrices import cholesky_lower
from hydrabeam_mpi.inference.posterior import Posterior
from hydrabeam_mpi.random import complex_normal, generator


@dataclass(frozen=True)
class ChannelTold:
    """What the data say of one channel's coefficients, in units of the prior's widths, about the prior's mean.

    Attributes
    ----------
    information : ndarray, (n, n)
        J.
    score : ndarray, (n,)
        h.
    level : float
        l, ln p(d) with the coefficients at the prior's mean; zero where no evidence is asked for.
    """

    information: Array
    score: Array
    level: float = 0.0

    @classmethod
    def of(cls, information: Array, score: Array, widths: FloatArray, level: float = 0.0) -> ChannelTold:
        """Take the same of the coefficients themselves; ``widths`` are (n,)."""
        return cls(information * widths * widths[:, np.newaxis], score * widths, level)

    def noise(self, keys: Sequence[tuple[int | str, ...]], seed: int, n_channels: int) -> Array:
        """Draw the channel's part of the noise of constrained realisations, one for each of the ``keys``, (n, Ndraws).

        Of covariance 1/N + J, N the number of all channels.
        """
        root = self.information.copy(order="F")
        root[np.diag_indices_from(root)] += 1 / n_channels
        return np.asarray(cholesky_lower(root) @ white(keys, seed, len(self.score), np.iscomplexobj(root)).T)


def white(keys: Sequence[tuple[int | str, ...]], seed: int, n: int, is_complex: bool) -> Array:
    """Draw numbers of variance one with a generator for each of the ``keys``, (Nkeys, n)."""
    rngs = [generator(seed, *key) for key in keys]
    drawn = [complex_normal(rng, (n,)) if is_complex else rng.standard_normal(n) for rng in rngs]
    return np.array(drawn, dtype=complex if is_complex else float).reshape(len(keys), n)


def noise_of_modes(modes: FloatArray, draws: Sequence[int], seed: int, n: int, is_complex: bool) -> Array:
    """Draw the part of the noise of constrained realisations that belongs to no channel, (M, n, Ndraws)."""
    rest = np.sqrt(np.maximum(1 - np.sum(modes**2, axis=0) / len(modes), 0.0))
    keys = [[("posterior draw over frequency", mode, draw) for draw in draws] for mode in range(modes.shape[1])]
    parts = [size * white(one, seed, n, is_complex).T for size, one in zip(rest, keys, strict=True)]
    return np.array(parts).reshape(len(rest), n, len(draws))


def choose_length(weights: FloatArray, seed: int, n_draws: int) -> Array:
    """Return of which length each draw is, with the ``weights`` of all lengths, (n_draws,)."""
    chances = np.array([generator(seed, "length of a posterior draw", draw).random() for draw in range(n_draws)])
    return np.minimum(np.searchsorted(np.cumsum(weights), chances, side="right"), np.flatnonzero(weights)[-1])


class CoupledEquations:
    """The system of all channels, added up channel by channel, and solved as one matrix.

    Parameters
    ----------
    modes : ndarray, (Nchan, M)
        U, with columns that are orthogonal.
    n : int
        Coefficients of a channel.
    is_complex : bool
    n_draws : int
        How many draws are to be made.
    """

    def __init__(self, modes: FloatArray, n: int, is_complex: bool, n_draws: int = 0) -> None:
        dtype, n_unknowns = np.complex128 if is_complex else np.float64, modes.shape[1] * n
        self.modes, self._n, self._is_complex, self._level = modes, n, is_complex, 0.0
        # Of the transpose, which is contiguous as LAPACK wants it, the lower triangle; (M, n, M, n).
        self._upper: Array = np.zeros((modes.shape[1], n, modes.shape[1], n), dtype)
        self._upper.reshape(n_unknowns, n_unknowns)[np.diag_indices(n_unknowns)] = 1.0
        self._source: Array = np.zeros((modes.shape[1], n), dtype)
        self._noise: Array = np.zeros((modes.shape[1], n, n_draws), dtype)

    def add(self, channel: int, told: ChannelTold, noise: Array | None = None) -> None:
        """Add what the data say of a channel, and its part of the draws' noise, (n, n_draws)."""
        weights = self.modes[channel]
        information = np.ascontiguousarray(told.information.T)[:, np.newaxis]
        for m, weight in enumerate(weights):
            self._upper[m, :, m:] += information * (weight * weights[m:])[:, np.newaxis]
        self._source += weights[:, np.newaxis] * told.score
        self._level += told.level
        if noise is not None:
            self._noise += weights[:, np.newaxis, np.newaxis] * noise

    def solve(self) -> CoupledPosterior:
        """Return the posterior; this object is of no use then."""
        kappa, size = 1.0 if self._is_complex else 2.0, self._source.size
        log_scale = self._level - size * np.log(kappa * np.pi) / kappa
        block = Block("modes along frequency", size, self._is_complex)
        matrix = self._upper.reshape(size, size).T
        posterior = Gaussian((block,), matrix, self._source.reshape(-1), float(log_scale)).solve(overwrite=True)
        return CoupledPosterior(self.modes, self._n, posterior, self._noise)


@dataclass(frozen=True)
class Moments:
    """Those of one channel's a, and draws of it: (n,), (n, n), (n_draws, n)."""

    mean: Array
    covariance: Array
    draws: Array


@dataclass(frozen=True)
class CoupledPosterior:
    """The posterior of all channels, in modes along frequency.

    Attributes
    ----------
    modes : ndarray, (Nchan, M)
    n : int
        Coefficients of a channel.
    joint : Posterior
        Of all c, mode by mode, (M n,).
    noise : ndarray, (M, n, n_draws)
        The channels' parts of that of draws.
    """

    modes: FloatArray
    n: int
    joint: Posterior
    noise: Array

    def moments(self, seed: int, numbers: Sequence[int]) -> Iterator[Moments]:
        """Yield those of each channel, with draws of some ``numbers``, those of all channels drawn together."""
        draws = self.draws(seed, numbers)
        for channel in range(len(self.modes)):
            mean = np.asarray(self.modes[channel] @ self.joint.mean.reshape(-1, self.n))
            yield Moments(mean, self.covariance_of(channel), draws[:, channel])

    def covariance_of(self, channel: int) -> Array:
        """Return that of a channel's a, (n, n)."""
        weights, size = self.modes[channel], self.modes.shape[1]
        half = (weights @ self.joint.covariance.reshape(size, -1)).reshape(self.n, size, self.n)
        return np.asarray(np.einsum("m,imj->ij", weights, half))

    def draws(self, seed: int, numbers: Sequence[int]) -> Array:
        """Draw a of all channels together, (len(numbers), Nchan, n)."""
        n_modes, is_complex = self.modes.shape[1], self.joint.is_complex
        noise = self.noise[..., list(numbers)] + noise_of_modes(self.modes, numbers, seed, self.n, is_complex)
        half = solve_triangular(self.joint.factor, noise.reshape(n_modes * self.n, -1), lower=True, check_finite=False)
        moved = solve_triangular(self.joint.factor, half, lower=True, trans="C", check_finite=False)
        drawn = (self.joint.mean[:, np.newaxis] + moved).reshape(n_modes, self.n, -1)
        return np.einsum("fm,mid->dfi", self.modes, drawn)
