"""Covariances over channels, K, and the modes U along frequency that they are made of, K = U U^T.

A coefficient in units of its prior's width has the covariance K over channels. Where K is of low rank, as with few
functions of frequency or a smooth kernel, so is U of few columns: modes, each with a standard normal coefficient.
Channels may lie anywhere; that of each with itself is one, or one on average with polynomials.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.linalg import eigh

from hydrabeam_mpi.data.observation import FloatArray

NEGLIGIBLE = 1e-14
"""Eigenvalues of K below this part of the largest are rounding errors; no data tell of what is so small beforehand."""


def modes_of(covariance: FloatArray, n_modes: int | None = None) -> FloatArray:
    """Return U, (Nchan, M), with U U^T a covariance over channels, (Nchan, Nchan), largest modes first.

    ``n_modes`` of the largest at most.
    """
    values, vectors = eigh(covariance)
    kept = np.flatnonzero(values > NEGLIGIBLE * values[-1])[::-1][:n_modes]
    return _upright(vectors[:, kept]) * np.sqrt(values[kept])


def inverse_over_channels(modes: FloatArray) -> FloatArray:
    """Return the inverse of K = U U^T among what the modes, (Nchan, M), orthogonal, can make, (Nchan, Nchan)."""
    scaled = modes / np.sum(modes**2, axis=0)
    return np.asarray(scaled @ scaled.T)


def legendre(freqs: FloatArray, n_modes: int) -> FloatArray:
    """Return polynomials of degree 0 to ``n_modes`` - 1 in frequency, orthogonal over the channels, (Nchan, n_modes).

    Each varies as much as the others; together they have a mean square of one.
    """
    low, high = freqs.min(), freqs.max()
    x = 2 * (freqs - low) / (high - low) - 1 if high > low else np.zeros_like(freqs)
    orthogonal: FloatArray = np.linalg.qr(legvander(x, n_modes - 1))[0]
    return np.asarray(_upright(orthogonal) * np.sqrt(len(freqs) / n_modes), dtype=float)


def within_delay(freqs: FloatArray, delay: float) -> FloatArray:
    """Return the covariance of equal power at all delays up to ``delay``, s, either way, (Nchan, Nchan).

    Its eigenvectors are discrete prolate spheroidal sequences where channels are evenly spaced (Slepian 1978).
    """
    return np.asarray(np.sinc(2 * delay * _differences(freqs)), dtype=float)


def squared_exponential(freqs: FloatArray, length: float) -> FloatArray:
    """Return exp(-x^2 / 2), x the difference in frequency over ``length``, both Hz, (Nchan, Nchan)."""
    return np.asarray(np.exp(-0.5 * (_differences(freqs) / length) ** 2))


def matern_three_halves(freqs: FloatArray, length: float) -> FloatArray:
    """Return the Matern covariance of functions with one derivative, (Nchan, Nchan); frequencies in Hz."""
    x = np.sqrt(3) * np.abs(_differences(freqs)) / length
    return np.asarray((1 + x) * np.exp(-x))


def matern_five_halves(freqs: FloatArray, length: float) -> FloatArray:
    """Return the Matern covariance of functions with two derivatives, (Nchan, Nchan); frequencies in Hz."""
    x = np.sqrt(5) * np.abs(_differences(freqs)) / length
    return np.asarray((1 + x + x**2 / 3) * np.exp(-x))


KERNELS = {
    "squared-exponential": squared_exponential,
    "matern-3/2": matern_three_halves,
    "matern-5/2": matern_five_halves,
}


def _differences(freqs: FloatArray) -> FloatArray:
    return np.asarray(freqs[:, np.newaxis] - freqs)


def _upright(vectors: FloatArray) -> FloatArray:
    """Give each of some vectors, (Nchan, M), the sign with which its largest component is positive."""
    top = np.argmax(np.abs(vectors), axis=0)
    return np.asarray(vectors * np.sign(vectors[top, np.arange(vectors.shape[1])]))
