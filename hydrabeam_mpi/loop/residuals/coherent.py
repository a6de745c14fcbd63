"""What residuals have in common with the model: gains, and how they change in time, and constants of baselines.

A wrong gain turns a part of the model into residual, with the model's phase on every baseline of an antenna. Sums of
z m*, with z the whitened residuals and m the whitened model, find it long before chi^2 does: k parameters of a chi^2
excess stand against the scatter of k squares, not of as many as there are visibilities.

Only what redundant baselines do not share enters: beam and sky move them alike, so that neither their errors nor what
else the model lacks of them has a part in these sums, which are exactly those of noise if only noise is left. Arrays
without redundant baselines have none.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray, IntArray, Observation
from hydrabeam_mpi.inference.significance import chi2_sigma
from hydrabeam_mpi.mpi import Comm, allreduce_sum

LEAST_LEFT = 1e-3
"""Least information that a look must have, as a fraction of that of the best constrained parameter."""
ROUNDING = 1e-9
GAINS, CHANGES = "gains", "changes of gains"
FACTORS, CONSTANTS = OF_BASELINES = "factors of baselines", "constants of baselines"
SPOTS, WANDERING_SPOTS = OF_TIMES = "bright spots", "bright spots of all times"
KINDS = (GAINS, CHANGES, *OF_BASELINES, *OF_TIMES)


@dataclass(frozen=True)
class CoherentRows:
    """Which antennas and groups a rank's baselines belong to.

    Attributes
    ----------
    bls : ndarray of int, (Nbls,)
        Indices into the observation's baselines, in whole redundant groups.
    antennas : ndarray of int, (Nbls, 2)
        Index of the first and the second antenna, in the sense of the group.
    member : ndarray of int, (Nbls,)
        The group.
    """

    bls: IntArray
    antennas: IntArray
    member: IntArray


@dataclass(frozen=True)
class CoherentSums:
    """Scores and information, additive over times and channels, and so over ranks.

    Attributes
    ----------
    gains : ndarray, (2, 2, Nfreqs, Nants, Nt)
        Score and information of each antenna's ln amplitude and phase.
    turned : ndarray, (2, 2, Nfreqs, Nbls)
        Of the factor, real and imaginary part, that each baseline has more than the others of its group.
    constant : ndarray, (2, 2, Nfreqs, Nbls)
        Of a constant, real and imaginary part, in units of the noise.
    """

    gains: FloatArray
    turned: FloatArray
    constant: FloatArray

    @classmethod
    def zeros(cls, n_freqs: int, n_ants: int, n_times: int, n_bls: int) -> CoherentSums:
        """Return the sums over nothing."""
        by_bl = (2, 2, n_freqs, n_bls)
        return cls(np.zeros((2, 2, n_freqs, n_ants, n_times)), np.zeros(by_bl), np.zeros(by_bl))

    def add(self, channel: int, times: IntArray, z: ComplexArray, m: ComplexArray, rows: CoherentRows) -> None:
        """Add the rows of one channel.

        Parameters
        ----------
        channel : int
        times : ndarray of int, (Ntimes,)
            Indices into the observation's times.
        z, m : ndarray of complex, (Ntimes, Nbls)
            Whitened residuals and model, both zero for rows that do not count.
        rows : CoherentRows
        """
        n_bls, n_groups = len(rows.member), int(rows.member.max(initial=-1)) + 1
        gather = csr_array((np.ones(n_bls), (np.arange(n_bls), rows.member)), shape=(n_bls, n_groups))
        power = np.abs(m) ** 2
        of_group = power @ gather
        inverse = np.divide(1.0, of_group, out=np.zeros_like(of_group), where=of_group > 0)
        z = z - m * (((m.conj() * z) @ gather) * inverse)[:, rows.member]
        left = _told(1 - power * inverse[:, rows.member], 1.0)

        product = m.conj() * z
        self._add_gains(channel, times, product, power, inverse, gather, rows)
        for sums, score, information in (
            (self.turned, product, power * left),
            (self.constant, z, np.where(power > 0, left, 0.0)),
        ):
            total = score.sum(axis=0)
            sums[0, :, channel, rows.bls] += np.stack([total.real, total.imag], axis=-1)
            sums[1, :, channel, rows.bls] += information.sum(axis=0)[:, np.newaxis]

    def _add_gains(
        self,
        channel: int,
        times: IntArray,
        product: ComplexArray,
        power: FloatArray,
        inverse: FloatArray,
        gather: Any,
        rows: CoherentRows,
    ) -> None:
        """Add scores m* z and information |m|^2 of both antennas of every row, less what groups have in common."""
        n_ants, n_bls = self.gains.shape[3], len(rows.member)
        for part, sign, score in ((0, 1.0, product.real), (1, -1.0, product.imag)):
            index = (np.tile(np.arange(n_bls), 2), rows.antennas.T.reshape(-1))
            touch = csr_array((np.repeat([1.0, sign], n_bls), index), shape=(n_bls, n_ants))
            information = power @ abs(touch)
            common = np.zeros_like(information)
            for t in range(len(times)):
                shared = gather.T @ touch.multiply(power[t][:, np.newaxis]).tocsr()
                common[t] = shared.power(2).T @ inverse[t]
            information = _told(information - common, information)
            self.gains[0, part, channel][:, times] += (score @ touch).T
            self.gains[1, part, channel][:, times] += information.T

    def reduce(self, comm: Comm) -> CoherentSums:
        """Add over ranks, in place. Collective: all ranks of `comm`."""
        for sums in (self.gains, self.turned, self.constant):
            allreduce_sum(comm, sums)
        return self


def _told(left: FloatArray, of: FloatArray | float) -> FloatArray:
    """Return zero for what is nothing but rounding."""
    return np.where(left > ROUNDING * of, left, 0.0)


@dataclass(frozen=True)
class Coherence:
    """Significances of one kind of coherent residual: of antennas, of baselines, or of times.

    Attributes
    ----------
    name : str
    index : ndarray of int, (K,)
        Antenna, baseline or time of each look.
    after : ndarray of int, (K,)
        Index of the last time before a change; -1 for what is constant.
    chi2, dof : ndarray, (K,)
    """

    name: str
    index: IntArray
    after: IntArray
    chi2: FloatArray
    dof: FloatArray

    def sigma(self, level: float = 1.0) -> FloatArray:
        """Return the significance of each look, where noise has variance ``level``, (Nlooks,)."""
        return chi2_sigma(self.chi2 / max(level, 1e-300), self.dof)

    def words(self, k: int, observation: Observation) -> str:
        """Name what a look is about."""
        lst = observation.lst_hours
        if self.name in OF_TIMES:
            return f"LST {lst[self.index[k]]:.2f} h" if self.name == SPOTS else "together"
        if self.name in OF_BASELINES:
            return "baseline {}-{}".format(*observation.antpairs[self.index[k]])
        antenna = f"antenna {observation.antenna_numbers[self.index[k]]}"
        if self.after[k] < 0:
            return antenna
        return f"{antenna} after LST {lst[self.after[k]]:.2f} h"


def coherences(sums: CoherentSums) -> Iterator[Coherence]:
    """Yield what there are data for: constant gains, gains that change, factors and constants of baselines."""
    score, information = sums.gains
    known = information > LEAST_LEFT * information.max(initial=0.0)
    score, information = np.where(known, score, 0.0), np.where(known, information, 0.0)
    yield from _looks(GAINS, score.sum(axis=-1)[..., np.newaxis], information.sum(axis=-1)[..., np.newaxis], False)
    before, before_info = score.cumsum(axis=-1)[..., :-1], information.cumsum(axis=-1)[..., :-1]
    after, after_info = (
        score.sum(axis=-1, keepdims=True) - before,
        information.sum(axis=-1, keepdims=True) - before_info,
    )
    both = (before_info > 0) & (after_info > LEAST_LEFT * information.max(initial=0.0))
    total = before_info + after_info
    weight = np.where(both, before_info * after_info / np.where(both, total, 1.0), 0.0)
    step = np.where(both, after / np.where(both, after_info, 1.0) - before / np.where(both, before_info, 1.0), 0.0)
    yield from _looks(CHANGES, step * weight, weight, True)
    for name, (by_score, by_information) in ((FACTORS, sums.turned), (CONSTANTS, sums.constant)):
        yield from _looks(name, by_score[..., np.newaxis], by_information[..., np.newaxis], False)


def _looks(name: str, score: FloatArray, information: FloatArray, steps: bool) -> Iterator[Coherence]:
    """Weigh scores, (2, Nfreqs, N, K), with all parts and channels together."""
    told = information > LEAST_LEFT * information.max(initial=0.0)
    chi2 = np.where(told, score**2 / np.where(told, information, 1.0), 0.0).sum(axis=(0, 1))
    dof = told.sum(axis=(0, 1))
    index, after = np.nonzero(dof)
    if len(index):
        chosen = (index, after)
        yield Coherence(
            name, index, after if steps else np.full(len(index), -1), chi2[chosen], dof[chosen].astype(float)
        )
