"""Slow modes of series in time or frequency that hold less than their noise, as a filter leaves them.

Each baseline's series is sky and noise. In a mode v of its samples, sum_t v_t d_t, the power is expected to be that of
the noise, sum_t v_t^2 sigma_t^2, or larger, whatever sky and instrument are; a filter takes away the noise as well.
Which modes a filter has taken is asked of the data: with z_s the K slowest modes of series s, in units in which its
noise has at least unit variance in each, they lie along the eigenvectors of sum_s z_s z_s^H of the least eigenvalues.

For n series of noise alone 1 / (W^-1)_kk of that matrix W is a Gamma variable of shape n - K + 1 (it is what of row k
the other rows do not have), and with any signal it is larger. As the least eigenvalue is no less than 1 / tr W^-1,

    P(least eigenvalue < x) <= K P(Gamma(n - K + 1) < K x).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.special import gammainc

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray
from hydrabeam_mpi.eigen import eigen
from hydrabeam_mpi.inference.robust import ABSURD_P
from hydrabeam_mpi.mpi import Comm, allreduce_sum

ORDERS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32)
"""Numbers of slowest modes that are looked at. A filter that takes more of them takes all of these."""
KINDS = 6
"""Looks at each: all times, each night and channels, with samples that count alike or by their weights."""
LEAST_NOISE = 0.98 * 0.8 ** np.arange(20)
"""Least noise of a mode by which series are chosen, over that of a series without flags: flags leave modes of some
series little of their own. No step is at one, where equal noise is, so that rounding does not decide."""
CHANCE = ABSURD_P / (KINDS * len(ORDERS))
"""Probability of each look, so that of a million healthy data sets one is called filtered."""
CHUNK = 2048
"""Series whose covariances are there at once: 16 MB of 32 modes."""


@dataclass(frozen=True)
class Series:
    """A rank's series along time or frequency.

    Attributes
    ----------
    places : ndarray, (N,)
        Times or frequencies, in any unit.
    data, model : ndarray of complex, (N, Nseries)
        Jy; zero where nothing is known.
    variance : ndarray, (N, Nseries)
        Of the noise, Jy^2; zero where nothing is known.
    """

    places: FloatArray
    data: ComplexArray
    model: ComplexArray
    variance: FloatArray

    @classmethod
    def of(cls, places: FloatArray, data: ComplexArray, model: ComplexArray, weights: FloatArray) -> Series:
        """Return series (N, Nseries) with inverse noise variances, each in units of its mean noise."""
        known = weights > 0
        variance = np.divide(1.0, weights, out=np.zeros(weights.shape), where=known)
        made = cls(places, np.where(known, data, 0.0), np.where(known, model, 0.0), variance)
        made._take_units_of_noise()
        return made

    def weighted(self) -> Series:
        """Return the series whose sums are sums with inverse noise variances, as of a weighted mean."""
        weights = np.divide(1.0, self.variance, out=np.zeros(self.variance.shape), where=self.variance > 0)
        made = replace(self, data=weights * self.data, model=weights * self.model, variance=weights)
        made._take_units_of_noise()
        return made

    def modes(self) -> FloatArray:
        """Return the slowest modes, polynomials orthonormal over all places, (N, up to N / 2)."""
        span = np.ptp(self.places) or 1.0
        within = 2 * (self.places - self.places.min()) / span - 1
        return np.linalg.qr(legvander(within, max(min(len(within) // 2, ORDERS[-1]), 1) - 1))[0]

    def _take_units_of_noise(self) -> None:
        n = np.count_nonzero(self.variance, axis=0)
        rms = np.sqrt(np.where(n > 0, self.variance.sum(axis=0), 1.0) / np.maximum(n, 1))
        for values, unit in ((self.data, rms), (self.model, rms), (self.variance, rms**2)):
            np.divide(values, unit, out=values)


@dataclass(frozen=True)
class Lacking:
    """Slow modes that hold less than noise.

    Attributes
    ----------
    n_modes, among : int
        How many, and of how many slowest ones.
    power, model : float
        Mean power in them over that of the noise: of the data, and of the model beam's visibilities.
    chance : float
        Probability that noise alone has the least of these by chance, or less.
    """

    n_modes: int
    among: int
    power: float
    model: float
    chance: float


def lacking_modes(comm: Comm, several: Sequence[Series], level: float, chance: float = CHANCE) -> Lacking | None:
    """Find the slow modes that a filter has taken out of series. Collective: all ranks of `comm`.

    Only as many modes are looked at as the model fills: in none of their combinations is it below the noise, so that
    what was taken matters, and that there is nothing is no matter of the sky.

    Parameters
    ----------
    comm : Comm
    several : sequence of Series
        Of each night for instance, over the same places on all ranks.
    level : float
        Power of the noise that data show over the one that is stated, at most one.
    chance : float
        Probability below which a mode lacks noise.

    Returns
    -------
    Lacking, optional
        The most modes that do, of the fewest slowest ones.
    """
    found: Lacking | None = None
    most = max((len(one.places) for one in several), default=0) // 2
    modes = [one.modes() for one in several]
    for k in (k for k in ORDERS if k <= most):
        least = [_least_noise(one, slow, k) for one, slow in zip(several, modes, strict=True)]
        floor, n = _floor(comm, np.concatenate(least), k)
        if n < 2 * k:
            break
        sums = np.zeros((2, k, k), complex)
        for one, slow, noise in zip(several, modes, least, strict=True):
            if slow.shape[1] < k:
                continue
            for part, values in zip(sums, (one.data, one.model), strict=True):
                z = slow[:, :k].T @ values[:, noise >= floor]
                part += z @ z.conj().T
        allreduce_sum(comm, sums)
        if np.linalg.eigvalsh(sums[1])[0] < n:
            break
        more = _told(sums, n, floor * level, chance)
        if more is not None and (found is None or more.n_modes > found.n_modes):
            found = more
    return found


def _told(sums: ComplexArray, n: int, noise: float, least: float) -> Lacking | None:
    """Tell of how many modes the data lack.

    Parameters
    ----------
    sums : ndarray of complex, (2, K, K)
        sum_s z_s z_s^H of data and of model.
    n : int
        Number of series.
    noise : float
        Least noise in a mode, which is taken as that of all.
    least : float
        Probability below which a mode lacks noise.
    """
    k = len(sums[0])
    powers, directions = eigen(sums[0])
    powers = np.maximum(powers, 0.0)
    chance = k * gammainc(n - k + 1, k * powers / noise)
    lacking = int(np.count_nonzero(chance < least))
    if not lacking:
        return None
    gone = directions[:, :lacking]
    model = float(np.einsum("kj,kl,lj->", gone.conj(), sums[1], gone).real)
    power = float(powers[:lacking].sum())
    return Lacking(lacking, k, power / (lacking * n), model / (lacking * n), float(chance[0]))


def _least_noise(series: Series, modes: FloatArray, k: int) -> FloatArray:
    """Return the least noise variance of a combination of the k slowest modes, of each series, (Nseries,).

    Zero where fewer than twice as many samples are known. What they are worth is not known of places without any.
    """
    n_known = np.count_nonzero(series.variance, axis=0)
    if modes.shape[1] < k:
        return np.zeros(len(n_known))
    # Without flags modes are as they are, and hold no less than the least noisy sample.
    least = series.variance.min(axis=0, initial=np.inf)
    gaps = np.flatnonzero((n_known < len(modes)) & (n_known >= 2 * k))
    slow = modes[:, :k]
    products = (slow[:, :, np.newaxis] * slow[:, np.newaxis, :]).reshape(len(slow), k * k)
    for start in range(0, len(gaps), CHUNK):
        part = gaps[start : start + CHUNK]
        covariances = (series.variance[:, part].T @ products).reshape(-1, k, k)
        least[part] = np.linalg.eigvalsh(covariances)[:, 0]
    return np.where(n_known >= 2 * k, least, 0.0)


def _floor(comm: Comm, least: FloatArray, k: int) -> tuple[float, int]:
    """Choose the series that tell most of k modes: return the noise that each has at least, and their number.

    Collective: all ranks of `comm`. Few series with all of their noise are worth as much as more with less.
    """
    counts = np.array([float(np.count_nonzero(least >= one)) for one in LEAST_NOISE])
    allreduce_sum(comm, counts)
    best = int(np.argmax(LEAST_NOISE * (counts - k + 1)))
    return float(LEAST_NOISE[best]), int(counts[best])
