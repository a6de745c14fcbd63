"""What all channels together say of unknowns that they share, with what they share of the model marginalised once.

The model may have a thousand unknowns that channels share, such as the fluxes of faint sources, and a set of effects a
few dozens. The order in which unknowns are marginalised does not matter: with those of the model, m, gone from the
likelihood of all channels' columns c, there is left

    K_cc - K_cm M^-1 K_mc,    M = sum over channels of K_mm + P^-1,

of which every set takes the few columns that it has. What a channel has for itself is a column of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hydrabeam_mpi.data.observation import BoolArray, FloatArray, IntArray
from hydrabeam_mpi.inference.gaussian import halves, in_units
from hydrabeam_mpi.inference.likelihood import Likelihood
from hydrabeam_mpi.loop.attribution.others import Others


@dataclass(frozen=True)
class AllChannels:
    """Columns of all channels, with the model marginalised.

    Attributes
    ----------
    by_channel : sequence of Likelihood
        Of all columns, (q,), with the model at zero.
    left, right : ndarray, (Nchannels, n, q + 1)
        Factors of K_cm M^-1 K_mc = left^T right, a channel's columns by another's. With the last column of ``right``,
        which is of the score of all, it is what the score loses.
    """

    by_channel: Sequence[Likelihood]
    left: FloatArray
    right: FloatArray

    @classmethod
    def of(cls, model: Others, by_channel: Sequence[Likelihood]) -> AllChannels:
        """Marginalise a model, all of which is shared, and which comes first in the likelihood of every channel."""
        n, q = len(model.shared), len(by_channel[0].score) - len(model.shared)
        with_prior = model.with_prior_score(by_channel)
        own, unit = in_units(sum(one.information[:n, :n] for one in with_prior) + model.precision[0])
        # Each channel's columns meet the score of all.
        score = sum(one.score[:n] for one in with_prior)
        columns = [np.column_stack([one.information[:n, n:], score]) for one in with_prior]
        factors = halves(own, unit[:, np.newaxis] * np.hstack(columns))[:2]
        left, right = (one.reshape(n, len(by_channel), q + 1).swapaxes(0, 1) for one in factors)
        return cls([_without_first(one, n) for one in by_channel], left, right)

    def beside(self, columns: IntArray, shared: BoolArray, prior_var: FloatArray, own: IntArray) -> Likelihood:
        """Return what all channels say of some columns that they share, ``own``, with others marginalised.

        Parameters
        ----------
        columns : ndarray of int, (p,)
            To marginalise.
        shared : ndarray of bool, (p,)
            Which of them channels share.
        prior_var : ndarray, (p,)
            Their prior variance, the same in all channels.
        own : ndarray of int, (m,)
        """
        each, common = columns[~shared], np.concatenate([columns[shared], own])
        n_each, n_channels = len(each), len(self.by_channel)
        size = n_channels * n_each + len(common)
        information, score, end = np.zeros((size, size)), np.zeros(size), slice(n_channels * n_each, size)
        signal = np.zeros((len(own), len(own)))
        left, right = (np.zeros((one.shape[1], size)) for one in (self.left, self.right))
        for f, one in enumerate(self.by_channel):
            mine = slice(f * n_each, (f + 1) * n_each)
            information[mine, mine] = one.information[np.ix_(each, each)]
            information[mine, end] = one.information[np.ix_(each, common)]
            information[end, end] += one.information[np.ix_(common, common)]
            score[mine], signal = one.score[each], signal + one.signal[np.ix_(own, own)]
            score[end] += one.score[common]
            for whole, parts in ((left, self.left[f]), (right, self.right[f])):
                whole[:, mine] = parts[:, each]
                whole[:, end] += parts[:, common]
        information[end, : end.start] = information[: end.start, end].T
        information -= left.T @ right
        score -= left.T @ self.right[0][:, -1]
        gone = np.arange(size - len(own))
        precision = np.diag(1 / np.concatenate([np.tile(prior_var[~shared], n_channels), prior_var[shared]]))
        every = Likelihood(0.5 * (information + information.T), score, np.zeros((size, size)))
        return replace(every.marginalised(gone, precision), signal=signal)


def _without_first(one: Likelihood, n: int) -> Likelihood:
    return Likelihood(one.information[n:, n:], one.score[n:], one.signal[n:, n:])
