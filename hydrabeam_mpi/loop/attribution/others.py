"""What is in the model beside an effect, and is marginalised where that is weighed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from hydrabeam_mpi.data.observation import BoolArray, FloatArray
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.fit.joint_step import precision_of_held
from hydrabeam_mpi.fit.state import Values
from hydrabeam_mpi.inference.likelihood import Likelihood


@dataclass(frozen=True)
class Others:
    """Unknowns that come first in the likelihood of every channel, and their prior.

    Attributes
    ----------
    shared : ndarray of bool, (p,)
        Whether channels share them.
    precision : tuple of ndarray, (p, p)
        Of their prior, a channel.
    score : tuple of ndarray, (p,)
        Gradient of ln prior where the likelihood has its zero, a channel.
    """

    shared: BoolArray
    precision: tuple[FloatArray, ...]
    score: tuple[FloatArray, ...]

    @classmethod
    def of(cls, values: Values, n_freqs: int) -> Others:
        """Return the active effects, of which what a fit holds at zero is held here as well.

        Free to move within its prior, what all gains have in common would make all that they act on as uncertain.
        """
        precision, score = [], []
        for f in range(n_freqs):
            of_held = [precision_of_held(one.held, one.prior.of(f).std()) for one in values.active]
            held = block_diag(np.zeros((0, 0)), *of_held)
            precision.append(values.prior_precision(f) + held)
            score.append(values.prior_score(f) - held @ values.x[f] if values.active else values.prior_score(f))
        return cls(values.shared, tuple(precision), tuple(score))

    def and_more(self, shared: BoolArray, prior_var: FloatArray) -> Others:
        """Return these and more after them, independent and around zero, both (n,); all variances are above zero."""
        n = len(prior_var)
        return Others(
            np.append(self.shared, shared),
            tuple(block_diag(one, np.diag(1 / prior_var)) for one in self.precision),
            tuple(np.append(one, np.zeros(n)) for one in self.score),
        )

    def taken_out(self, by_channel: Sequence[Likelihood], for_shared: bool) -> tuple[Others, list[Likelihood]]:
        """Marginalise, once for all sets that `and_more` may add, what does not have to wait for these.

        What channels share waits for the sum over several channels, where that is asked for; see `marginalised`.
        Returns what waits, and what is left for it and for the unknowns that come after it.
        """
        waits = self.shared if for_shared and len(by_channel) > 1 else np.zeros_like(self.shared)
        if not waits.any():
            return self._some(waits), self.marginalised(by_channel, for_shared=False)
        now, own = np.flatnonzero(~waits), replace(self, score=tuple(np.where(waits, 0.0, one) for one in self.score))
        left = [
            one.marginalised(now, precision[np.ix_(now, now)])
            for one, precision in zip(own.with_prior_score(by_channel), self.precision, strict=True)
        ]
        return self._some(waits), left

    def _some(self, which: BoolArray) -> Others:
        """Return some of these, which (p,) says."""
        square = np.ix_(which, which)
        precision, score = (one[square] for one in self.precision), (one[which] for one in self.score)
        return Others(self.shared[which], tuple(precision), tuple(score))

    def marginalised(self, by_channel: Sequence[Likelihood], for_shared: bool) -> list[Likelihood]:
        """Return what is left for the unknowns that come after them: of each channel, or ``for_shared`` ones of all.

        Those of a channel are marginalised in each. So are those that channels share, for what is each channel's own,
        where every channel counts its part of their prior; else after the sum over channels.
        """
        shared, n_freqs, own = self.shared, len(by_channel), np.flatnonzero(~self.shared)
        blocks = [
            one.marginalised(own, precision[np.ix_(own, own)])
            for one, precision in zip(self.with_prior_score(by_channel), self.precision, strict=True)
        ]
        n_shared = int(shared.sum())
        common = self.precision[0][np.ix_(shared, shared)]
        if for_shared:
            total = sum(blocks[1:], start=blocks[0])
            return [total.marginalised(np.arange(n_shared), common)]
        return [block.marginalised(np.arange(n_shared), common / n_freqs) for block in blocks]

    def best(self, by_channel: Sequence[Likelihood]) -> list[FloatArray]:
        """Return their most probable values in each channel, (p,), with all else at zero."""
        shared, own, n = self.shared, np.flatnonzero(~self.shared), len(self.shared)
        cut = [
            replace(one, information=one.information[:n, :n], score=one.score[:n], signal=one.signal[:n, :n])
            for one in self.with_prior_score(by_channel)
        ]
        left = [one.marginalised(own, p[np.ix_(own, own)]) for one, p in zip(cut, self.precision, strict=True)]
        total = sum(left[1:], start=left[0])
        common = np.linalg.solve(total.information + self.precision[0][np.ix_(shared, shared)], total.score)
        found = []
        for one, precision in zip(cut, self.precision, strict=True):
            x = np.zeros(n)
            x[shared] = common
            square = np.ix_(own, own)
            x[own] = np.linalg.solve(
                one.information[square] + precision[square],
                one.score[own] - one.information[np.ix_(own, np.flatnonzero(shared))] @ common,
            )
            found.append(x)
        return found

    def with_prior_score(self, by_channel: Sequence[Likelihood]) -> list[Likelihood]:
        """Return the same with the gradient of the prior, of which each channel counts its part for what they share."""
        share, found = np.where(self.shared, 1 / len(by_channel), 1.0), []
        for one, of_prior in zip(by_channel, self.score, strict=True):
            score = one.score.copy()
            score[: len(share)] += share * of_prior
            found.append(replace(one, score=score))
        return found


def beside_model(values: Values, effect: Effect, by_channel: Sequence[Likelihood]) -> list[Likelihood]:
    """Return what is left for an effect, which comes last in each channel's likelihood, with the model marginalised.

    Of each channel, or the sum over them where they share its parameters.
    """
    blocks = Others.of(values, len(by_channel)).marginalised(by_channel, effect.shared) if values.active else by_channel
    return [sum(blocks[1:], start=blocks[0])] if effect.shared else list(blocks)
