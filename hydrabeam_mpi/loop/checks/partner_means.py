"""The mean of each baseline's redundant partners: what it should see as well, whatever the model."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from hydrabeam_mpi.data.observation import BoolArray, ComplexArray, FloatArray, IntArray


@dataclass(frozen=True)
class PartnerMeans:
    """Samples of a channel beside the means of their redundant partners, all (Ntimes, Nbls).

    Attributes
    ----------
    data, mean : ndarray of complex
        Jy; the mean is weighted by inverse noise variance. Zero where it is not known.
    variance, variance_of_mean : ndarray
        Of their noise, Jy^2; one where it is not known.
    n : ndarray
        Number of partners that count.
    known : ndarray of bool
        Where the sample counts, and as many partners as are asked for.
    """

    data: ComplexArray
    mean: ComplexArray
    variance: FloatArray
    variance_of_mean: FloatArray
    n: FloatArray
    known: BoolArray


def partner_means(
    group: IntArray, data: ComplexArray, weights: FloatArray, least_partners: int
) -> Iterator[PartnerMeans]:
    """Yield each channel's samples beside the means of at least so many partners.

    Parameters
    ----------
    group : ndarray of int, (Nbls,)
        Redundant group of each baseline.
    data : ndarray of complex, (Nfreqs, Ntimes, Nbls)
    weights : ndarray, (Nfreqs, Ntimes, Nbls)
        Inverse noise variance of what counts, else zero.
    least_partners : int
    """
    groups, member = np.unique(group, return_inverse=True)
    summed = csr_array((np.ones(len(member)), (member, np.arange(len(member)))), shape=(len(groups), len(member)))
    for values, inverse in zip(data, weights, strict=True):
        total = (summed @ inverse.T).T[:, member] - inverse
        weighted = (summed @ (inverse * values).T).T[:, member] - inverse * values
        n = (summed @ (inverse > 0).T.astype(float)).T[:, member] - (inverse > 0)
        known = (inverse > 0) & (n >= least_partners)
        total = np.where(known, total, 1.0)
        mean = np.where(known, weighted / total, 0.0)
        yield PartnerMeans(np.where(known, values, 0.0), mean, 1 / np.where(known, inverse, 1.0), 1 / total, n, known)
