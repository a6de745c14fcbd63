"""Power spectra of sampled noise whose expectation is known whatever the sampling and the flags."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import fft

from hydrabeam_mpi.data.observation import Array, FloatArray, IntArray

COLUMNS_AT_ONCE = 4096


@dataclass(frozen=True)
class Spectrum:
    """Where spectra are taken and over which runs of samples.

    Attributes
    ----------
    x : ndarray, (N,)
        Abscissae of the samples, ascending.
    runs : tuple of ndarray of int
        Indices of samples that are transformed together; their powers are added.
    values : ndarray, (K,)
        Conjugate variable, in the order of `numpy.fft.fftfreq`; empty where there is nothing to transform.
    """

    x: FloatArray
    runs: tuple[IntArray, ...]
    values: FloatArray

    @classmethod
    def of(cls, x: FloatArray, whole: bool = False) -> Spectrum:
        """Lay out the spectra of samples at ``x``, (Nsamples,).

        Unless ``whole``, samples are cut into runs where a step differs from the usual one by more than half, as
        between nights. Runs shorter than half the longest are left out.
        """
        if len(x) < 2:
            return cls(x, (), np.zeros(0))
        steps = np.diff(x)
        usual = float(np.median(steps))
        cuts = np.flatnonzero(np.abs(steps / usual - 1) > 0.5) + 1 if not whole else np.zeros(0, dtype=int)
        runs = np.split(np.arange(len(x)), cuts)
        longest = max(runs, key=len)
        n = len(longest)
        if n < 2:
            return cls(x, (), np.zeros(0))
        kept = tuple(run for run in runs if 2 * len(run) >= n and len(run) > 1)
        return cls(x, kept, np.fft.fftfreq(n, (x[longest[-1]] - x[longest[0]]) / (n - 1)))

    @property
    def step(self) -> float:
        """Distance of neighbouring values."""
        return float(self.values[1] - self.values[0]) if len(self.values) > 1 else 0.0

    def power(self, z: Array) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Transform the columns of ``z``, (N, M), NaN where there are no samples.

        Yields
        ------
        power : ndarray, (K,)
            |sum_n z_n exp(-2 pi i v x_n)|^2 / (number of samples), added over columns: of independent samples with
            parts N(0, 1) each column adds chi^2 with two degrees of freedom at every value.
        samples : ndarray, (Nc,)
            Number of samples of each column that took part: those with half of the run's at least.
        """
        for run in self.runs:
            for start in range(0, z.shape[1], COLUMNS_AT_ONCE):
                part = z[run, start : start + COLUMNS_AT_ONCE]
                samples = np.sum(~np.isnan(part.real), axis=0)
                enough = 2 * samples >= len(run)
                if enough.any():
                    transformed = self._transform(np.nan_to_num(part[:, enough]), self.x[run])
                    yield np.sum(np.abs(transformed) ** 2 / samples[enough], axis=1), samples[enough].astype(float)

    def _transform(self, z: Array, x: FloatArray) -> Array:
        steps = np.diff(x) * len(self.values) * self.step
        if np.abs(steps - 1).max() < 1e-3:
            return fft.fft(z, n=len(self.values), axis=0)
        return np.exp(-2j * np.pi * np.outer(self.values, x - x[0])) @ z
