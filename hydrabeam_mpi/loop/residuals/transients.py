"""Bright spots: what is left at each single time as an image of the sky.

A satellite, an aeroplane, the Sun or a transient moves or lasts only briefly. No sum over times
along the sky or along the ground finds it, and chi^2 of a time spreads it over all baselines. The matched filter of
one direction s,

    T(s) = Re sum_b w_b r_b exp(-2 pi i nu b.s/c) / sqrt(sum_b w_b),

has variance one for noise wherever it looks, and the largest |T| of a time, corrected for the number of directions, is
the probability that noise has such a spot. Probabilities of all times together (Fisher's method) tell a faint spot that
moves.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hydrabeam_mpi.data.observation import C_M_PER_S, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.inference.significance import log_p_of_looks, log_p_two_sided
from hydrabeam_mpi.loop.residuals.coherent import SPOTS, WANDERING_SPOTS, Coherence
from hydrabeam_mpi.mpi import Comm, allreduce_sum

MOST_DIRECTIONS = 16384
MOST_PIXELS = 4_000_000
"""Directions times times, at most."""
OVERSAMPLING = 2.0


@dataclass(frozen=True)
class TransientSums:
    """Images of all times, additive over channels and redundant groups, and so over ranks.

    Attributes
    ----------
    directions : ndarray, (Ndirections, 3)
        Unit vectors, ENU.
    longest : float
        Baselines beyond this length would need finer directions, and do not count; metres.
    image : ndarray, (Ntimes, Ndirections)
    weight : ndarray, (Ntimes,)
    """

    directions: FloatArray
    longest: float
    image: FloatArray
    weight: FloatArray

    @classmethod
    def zeros(cls, n_times: int, vectors: FloatArray, freq: float) -> TransientSums:
        """Choose directions for baselines ``vectors``, (Ngroups, 3), at the highest frequency."""
        most = min(MOST_DIRECTIONS, MOST_PIXELS // max(n_times, 1))
        wavelength = C_M_PER_S / freq
        # Direction cosines in steps of wavelength / (2 length).
        longest = min(float(np.linalg.norm(vectors, axis=1).max()), wavelength * np.sqrt(most / np.pi) / OVERSAMPLING)
        n = max(int(np.ceil(OVERSAMPLING * longest / wavelength)), 1)
        east, north = (axis.ravel() / n for axis in np.mgrid[-n : n + 1, -n : n + 1])
        up2 = 1 - east**2 - north**2
        seen = up2 >= 0
        directions = np.stack([east, north, np.sqrt(np.maximum(up2, 0.0))], axis=-1)[seen]
        return cls(directions, longest, np.zeros((n_times, len(directions))), np.zeros(n_times))

    def add(
        self, times: IntArray, z: ComplexArray, root: FloatArray, vectors: FloatArray, member: IntArray, freq: float
    ) -> None:
        """Add the rows of one channel.

        Parameters
        ----------
        times : ndarray of int, (Ntimes,)
            Indices into the observation's times.
        z : ndarray of complex, (Ntimes, Nbls)
            Whitened residuals, parts of variance one; zero for rows that do not count.
        root : ndarray, (Ntimes, Nbls)
            Square root of twice the inverse noise variance; zero likewise.
        vectors : ndarray, (Ngroups, 3)
            Metres ENU.
        member : ndarray of int, (Nbls,)
            The group of each baseline.
        freq : float
            Hz.
        """
        short = np.linalg.norm(vectors, axis=1) <= self.longest * (1 + 1e-9)
        by_group = np.zeros((len(vectors), len(times)), dtype=complex)
        np.add.at(by_group, member, (root * z).T)
        phase = (2 * np.pi * freq / C_M_PER_S) * (vectors[short] @ self.directions.T)
        chosen = by_group[short].T
        self.image[times] += chosen.real @ np.cos(phase) + chosen.imag @ np.sin(phase)
        self.weight[times] += (root**2)[:, short[member]].sum(axis=1)

    def reduce(self, comm: Comm) -> TransientSums:
        """Add over ranks, in place. Collective: all ranks of `comm`."""
        allreduce_sum(comm, self.image)
        allreduce_sum(comm, self.weight)
        return self


def transients(sums: TransientSums) -> Iterator[Coherence]:
    """Yield the brightest spot of every time, and all of them together, each as chi^2 = -2 ln p of two degrees."""
    times = np.flatnonzero(sums.weight > 0)
    if not len(times):
        return
    largest = np.abs(sums.image[times]).max(axis=1) / np.sqrt(sums.weight[times])
    alone = log_p_two_sided(largest)
    chi2 = np.array([-2 * log_p_of_looks(float(one), len(sums.directions)) for one in alone])
    never = np.full(len(times), -1)
    yield Coherence(SPOTS, times, never, chi2, np.full(len(times), 2.0))
    yield Coherence(WANDERING_SPOTS, times[:1], never[:1], chi2.sum(keepdims=True), np.array([2.0 * len(times)]))
