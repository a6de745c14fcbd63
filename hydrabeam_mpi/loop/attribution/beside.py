"""What channels say of an effect beside what is in the model, which is marginalised."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy.linalg import lu_factor, lu_solve

from hydrabeam_mpi.data.observation import BoolArray, FloatArray
from hydrabeam_mpi.fit.state import Values
from hydrabeam_mpi.inference.likelihood import Likelihood
from hydrabeam_mpi.loop.attribution.others import Others


@dataclass(frozen=True)
class Beside:
    """What a channel says of the model's effects and a candidate after them; what it says of the former all share.

    Attributes
    ----------
    model : Likelihood
        Of the q parameters of the model's effects.
    across : ndarray, (q, p)
        Information on these with the candidate's.
    own : Likelihood
        Of the candidate's p.
    """

    model: Likelihood
    across: FloatArray
    own: Likelihood

    @classmethod
    def of(cls, model: Likelihood, whole: Likelihood) -> Self:
        """Take what is about the candidate out of the likelihood of all."""
        q = len(model.score)
        own = whole.information[q:, q:].copy(), whole.score[q:].copy(), whole.signal[q:, q:].copy()
        return cls(model, whole.information[:q, q:].copy(), Likelihood(*own))

    def of_first(self, n: int) -> Self:
        """Return the same with the first ``n`` of the candidate's parameters, the others at zero."""
        return replace(self, across=self.across[:, :n], own=self.own.first(n))


class KnownModel:
    """What is in the model, factored once for all that is weighed beside it.

    Parameters
    ----------
    model : Others
    channels : list of Likelihood
        What each channel says of its parameters.
    """

    def __init__(self, model: Others, channels: Sequence[Likelihood]) -> None:
        # For what is each channel's own every channel counts its part of the prior of what they share.
        part = np.where(np.outer(model.shared, model.shared), 1 / len(channels), 1.0)
        parts = zip(model.with_prior_score(channels), model.precision, strict=True)
        self._channels = [_Channel(one.information + part * prior, one.score, model.shared) for one, prior in parts]
        left = zip(*(one.left for one in self._channels), strict=True)
        self._of_common = _Factored(*(np.sum(each, axis=0) for each in left))

    @classmethod
    def of(cls, values: Values, told: Sequence[Beside]) -> Self:
        """Take it from what channels say of any candidate beside the active effects."""
        return cls(Others.of(values, len(told)), [one.model for one in told])

    def left(self, told: Sequence[Beside], shared: bool) -> list[Likelihood]:
        """Return what channels say of a candidate, each by itself or the sum over all where they share it."""
        pairs = list(zip(self._channels, told, strict=True))
        if not shared:
            return [channel.whole.without(one.across, one.own) for channel, one in pairs]
        across, own = zip(*(channel.without_own(one) for channel, one in pairs), strict=True)
        return [self._of_common.without(np.sum(across, axis=0), sum(own[1:], start=own[0]))]


class _Channel:
    """What is in the model of one channel: all of it (``whole``), and what it does not share (``of_own``), factored.

    ``left`` is the precision and the score of what it shares, with its own marginalised.
    """

    def __init__(self, precision: FloatArray, score: FloatArray, shared: BoolArray) -> None:
        self._own, self._common = np.flatnonzero(~shared), np.flatnonzero(shared)
        self.whole = _Factored(precision, score)
        self.of_own = _Factored(precision[np.ix_(self._own, self._own)], score[self._own])
        across = precision[np.ix_(self._own, self._common)]
        self._follow = self.of_own.solve(across)
        left = precision[np.ix_(self._common, self._common)] - across.T @ self._follow
        self.left = left, score[self._common] - self._follow.T @ score[self._own]

    def without_own(self, told: Beside) -> tuple[FloatArray, Likelihood]:
        """Return what it says of a candidate, with what it shares and by itself, its own parameters marginalised."""
        own, common = told.across[self._own], told.across[self._common]
        return common - self._follow.T @ own, self.of_own.without(own, told.own)


class _Factored:
    """The posterior of some parameters, of this precision, (n, n), and ``score``, (n,), at zero.

    It is factored in units in which the diagonal is one, where directions that nothing determines but rounding errors
    of either sign are no obstacle.
    """

    def __init__(self, precision: FloatArray, score: FloatArray) -> None:
        own = np.diag(precision)
        self._unit = 1 / np.sqrt(np.where(own > 0, own, 1.0))
        self._factor = lu_factor(self._unit[:, np.newaxis] * precision * self._unit) if len(score) else None
        self._score = score

    def solve(self, columns: FloatArray) -> FloatArray:
        """Return the inverse of the precision times columns, (n, k)."""
        if self._factor is None:
            return np.zeros_like(columns)
        unit = self._unit[:, np.newaxis]
        return np.asarray(unit * lu_solve(self._factor, unit * columns))

    def without(self, across: FloatArray, own: Likelihood) -> Likelihood:
        """Return what is left of the likelihood of others, with these marginalised; ``across`` is (n, p)."""
        followed = self.solve(across)
        information = own.information - across.T @ followed
        return replace(own, information=0.5 * (information + information.T), score=own.score - followed.T @ self._score)
