"""Additive statistics of whitened residuals at held-out rows."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from hydrabeam_mpi.data.observation import Array, BoolArray, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.loop.residuals.cube import Cube, Layout
from hydrabeam_mpi.loop.residuals.spectra import Spectrum
from hydrabeam_mpi.mpi import Comm, allreduce_sum

WITHIN_GROUPS, NEIGHBOURING_TIMES, NEIGHBOURING_CHANNELS = range(3)


@dataclass
class ResidualSums:
    """Sums over whitened residuals z, additive over baselines in whole redundant groups, and so over ranks.

    Attributes
    ----------
    by_baseline, by_time, by_channel : ndarray, (2, Nbls), (2, Nt), (2, Nfreqs)
        Number of visibilities and sum of |z|^2.
    by_fringe_rate, by_delay : ndarray, (2, K)
        Number of spectra and sum of their powers at the values of ``layout.fringe_rates`` and ``layout.delays``.
    oversampling : ndarray, (2, 2)
        For fringe rates and delays: number of spectra, and sum of the number of values over that of samples.
    pairs : ndarray, (3, 3)
        For pairs of a redundant group at one time and channel, of neighbouring times, and of neighbouring channels:
        number of pairs, sum of Re z_i z_j*, sum of (|z_i|^2 + |z_j|^2) / 2.
    common : ndarray, (4,)
        Of groups with two visibilities or more at one time and channel: number of these, sum of |sum z|^2 / n, number
        of visibilities, sum of |z|^2. The second is chi^2 with twice the first degrees of freedom, whatever the
        groups' sizes, and independent of what is left of the last.
    quartic : ndarray, (1,)
        Sum of |z|^4.
    largest : tuple of (float, int, int, int)
        Largest |z|^2 and its indices of channel, time and baseline in the layout's observation.
    """

    by_baseline: FloatArray
    by_time: FloatArray
    by_channel: FloatArray
    by_fringe_rate: FloatArray
    by_delay: FloatArray
    oversampling: FloatArray
    pairs: FloatArray
    common: FloatArray
    quartic: FloatArray
    largest: tuple[float, int, int, int] = (0.0, 0, 0, 0)

    @classmethod
    def zeros(cls, layout: Layout) -> ResidualSums:
        """Return the sums over nothing."""
        n_freqs, n_times, n_bls = layout.shape
        return cls(
            by_baseline=np.zeros((2, n_bls)),
            by_time=np.zeros((2, n_times)),
            by_channel=np.zeros((2, n_freqs)),
            by_fringe_rate=np.zeros((2, len(layout.fringe_rates.values))),
            by_delay=np.zeros((2, len(layout.delays.values))),
            oversampling=np.zeros((2, 2)),
            pairs=np.zeros((3, 3)),
            common=np.zeros(4),
            quartic=np.zeros(1),
        )

    @classmethod
    def of(cls, cube: Cube) -> ResidualSums:
        """Return the sums over a rank's baselines."""
        sums = cls.zeros(cube.layout)
        if not cube.z.size:
            return sums
        _, places = np.unique(cube.layout.redundant.group[cube.bls], return_inverse=True)
        member = csr_array((np.ones(len(places)), (np.arange(len(places)), places)))
        steps = _neighbours(cube.layout.observation.times[cube.layout.times])
        channels = set(_neighbours(cube.layout.observation.freqs).tolist())
        for f in range(len(cube.z)):
            z, used = cube.channel(f)
            sums._add_powers(f, z, used, cube)
            sums._add_groups(z, used, member)
            sums._add_pairs(NEIGHBOURING_TIMES, z[steps], used[steps], z[steps + 1], used[steps + 1])
            sums._add_spectra(0, sums.by_fringe_rate, cube.layout.fringe_rates, cube.z[f])
            if f in channels:
                sums._add_pairs(NEIGHBOURING_CHANNELS, z, used, *cube.channel(f + 1))
        for t in range(cube.z.shape[1]):
            sums._add_spectra(1, sums.by_delay, cube.layout.delays, cube.z[:, t])
        return sums

    def reduce(self, comm: Comm) -> ResidualSums:
        """Add over ranks, in place. Collective: all ranks of `comm`."""
        for field in fields(self):
            if field.name != "largest":
                allreduce_sum(comm, getattr(self, field.name))
        self.largest = max(comm.allgather(self.largest))
        return self

    @property
    def n(self) -> float:
        """Number of visibilities."""
        return float(self.by_time[0].sum())

    @property
    def chi2(self) -> float:
        """Sum of |z|^2: chi^2 with 2n degrees of freedom."""
        return float(self.by_time[1].sum())

    def _add_powers(self, f: int, z: ComplexArray, used: BoolArray, cube: Cube) -> None:
        power = np.abs(z) ** 2
        for row, values in enumerate((used, power)):
            self.by_baseline[row, cube.bls] += values.sum(axis=0)
            self.by_time[row] += values.sum(axis=1)
            self.by_channel[row, f] += values.sum()
        self.quartic += np.sum(power**2)
        t, b = np.unravel_index(np.argmax(power), power.shape)
        found = (float(power[t, b]), f, int(cube.layout.times[t]), int(cube.bls[b]))
        self.largest = max(self.largest, found)

    def _add_groups(self, z: ComplexArray, used: BoolArray, member: Any) -> None:
        n, power = used.astype(float) @ member, np.abs(z) ** 2 @ member
        shared = np.abs(z @ member) ** 2
        several = n > 1
        n, power, shared = n[several], power[several], shared[several]
        self.common += [n.size, np.sum(shared / n), n.sum(), power.sum()]
        self.pairs[WITHIN_GROUPS] += 0.5 * np.array(
            [np.sum(n * (n - 1)), np.sum(shared - power), np.sum((n - 1) * power)]
        )

    def _add_pairs(
        self, kind: int, z: ComplexArray, used: BoolArray, other: ComplexArray, other_used: BoolArray
    ) -> None:
        both = used & other_used
        one, two = z[both], other[both]
        level = 0.5 * (np.sum(np.abs(one) ** 2) + np.sum(np.abs(two) ** 2))
        self.pairs[kind] += [one.size, np.sum((one * two.conj()).real), level]

    def _add_spectra(self, which: int, sums: FloatArray, spectrum: Spectrum, z: Array) -> None:
        for power, samples in spectrum.power(z):
            sums[0] += len(samples)
            sums[1] += power
            self.oversampling[which] += [len(samples), np.sum(len(power) / samples)]


def _neighbours(x: FloatArray) -> IntArray:
    """Return the indices of samples whose next one is no further than 1.5 times the usual step."""
    steps = np.diff(x)
    return np.flatnonzero(steps < 1.5 * np.median(steps)) if len(steps) else np.zeros(0, dtype=int)
