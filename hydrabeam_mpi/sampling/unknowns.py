"""The effects' parameters that a chain moves, as one vector, and those combinations of them that may move."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag, cho_solve, null_space

from hydrabeam_mpi.data.observation import BoolArray, FloatArray, IntArray
from hydrabeam_mpi.data.partition import spans
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.fit.state import Active, Values
from hydrabeam_mpi.inference.likelihood import Likelihood
from hydrabeam_mpi.inference.prior import precision_of


@dataclass(frozen=True)
class Unknowns:
    """The parameters in use of some of the effects, side by side; those that channels share are there once.

    Attributes
    ----------
    values : Values
        The model's effects. Those that do not move stay as they are here.
    moving : tuple of int
        Places of the effects that move.
    n_freqs : int
        Number of the job's channels.
    channels_apart : bool
        Whether nothing but the effects' priors may make parameters of different channels depend on each other.
    width_of : ndarray of int, (n,)
        Number of the width that is drawn of the prior of each entry of the vector, or -1; empty where there are none.
    """

    values: Values
    moving: tuple[int, ...]
    n_freqs: int
    channels_apart: bool = True
    width_of: IntArray = field(default_factory=lambda: np.zeros(0, dtype=int))

    @property
    def active(self) -> list[Active]:
        """The effects that move."""
        return [self.values.active[place] for place in self.moving]

    @cached_property
    def spans(self) -> list[slice]:
        """Where each of them is in the vector."""
        return spans(one.size * self._n_sets(one) for one in self.active)

    @property
    def size(self) -> int:
        """Length of the vector."""
        return self.spans[-1].stop if self.spans else 0

    def vector(self, values: Values) -> FloatArray:
        """Return the parameters, (n,)."""
        here = [values.active[place] for place in self.moving]
        return np.concatenate([np.zeros(0), *(one.x[: self._n_sets(one), one.used].reshape(-1) for one in here)])

    def at(self, vector: FloatArray) -> Values:
        """Return the effects with other parameters, (n,)."""
        if not self.moving:
            return self.values
        x = self.values.x.copy()
        for place, one, span in zip(self.moving, self.active, self.spans, strict=True):
            x[:, self.values.spans[place]] = vector[span].reshape(self._n_sets(one), one.size)
        return self.values.at(x)

    def of_channel(self, channel: int) -> tuple[IntArray, IntArray]:
        """Return where a channel's parameters are in the vector, and where among those of all effects, (m,) each."""
        here, among = [np.zeros(0, dtype=int)], [np.zeros(0, dtype=int)]
        for place, one, span in zip(self.moving, self.active, self.spans, strict=True):
            first = span.start + (channel % self._n_sets(one)) * one.size
            here.append(np.arange(first, first + one.size))
            found = self.values.spans[place]
            among.append(np.arange(found.start, found.stop))
        return np.concatenate(here), np.concatenate(among)

    @cached_property
    def free(self) -> FloatArray:
        """The directions in which the vector may move, (n, n_free), orthonormal: those that nothing holds at zero.

        Those of single channels come first, channel by channel.
        """
        return self._directions[0]

    @cached_property
    def channel_of_free(self) -> IntArray:
        """The channel that each of them is of alone, or the number of channels where it is of several, (n_free,)."""
        return self._directions[1]

    @cached_property
    def _directions(self) -> tuple[FloatArray, IntArray]:
        directions, channels = [np.zeros((0, 0))], [np.zeros(0, dtype=int)]
        for one in self.active:
            n_sets, of_one = self._n_sets(one), null_space(one.held)
            directions.append(np.kron(np.eye(n_sets), of_one))
            of_sets = np.arange(n_sets) if self._is_apart(one) else np.full(n_sets, self.n_freqs)
            channels.append(np.repeat(of_sets, of_one.shape[1]))
        channel_of = np.concatenate(channels)
        order = np.argsort(channel_of, kind="stable")
        return np.asarray(block_diag(*directions)[:, order]), channel_of[order]

    def prior_precision(self) -> FloatArray:
        """Return the precision of the vector's prior, (n, n)."""
        precision = np.zeros((self.size, self.size))
        for one, span in zip(self.active, self.spans, strict=True):
            for channels, prior in one.prior.pieces(self.n_freqs):
                where = slice(span.start + channels.start * one.size, span.start + channels.stop * one.size)
                precision[where, where] = precision_of(prior)
        return precision

    def prior_score(self, vector: FloatArray) -> FloatArray:
        """Return the gradient of the logarithm of the prior, (n,)."""
        values, score = self.at(vector), np.zeros(self.size)
        for place, span in zip(self.moving, self.spans, strict=True):
            one = values.active[place]
            score[span] = one.prior.score(one.x[:, one.used])[: self._n_sets(one)].reshape(-1)
        return score

    def posterior(
        self, vector: FloatArray, likelihoods: Sequence[Likelihood], noise: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return what the linear model says of steps in the free directions from a vector, with the prior.

        Parameters
        ----------
        vector : ndarray, (n,)
        likelihoods : sequence of Likelihood
            Of each channel and all effects, linearised there, by the stated noise.
        noise : ndarray, (Nfreqs,)
            Scale of its variance.

        Returns
        -------
        mean : ndarray, (n_free,)
        factor : ndarray, (n_free, n_free)
            Lower L with L L^T the precision.

        Raises
        ------
        InputError
            If data and prior leave some of them free.
        """
        precision, score = self.prior_precision(), self.prior_score(vector)
        for channel, one in enumerate(likelihoods):
            here, among = self.of_channel(channel)
            precision[np.ix_(here, here)] += one.information[np.ix_(among, among)] / noise[channel]
            score[here] += one.score[among] / noise[channel]
        return self._solved(precision, score)

    def posterior_together(
        self, vector: FloatArray, information: FloatArray, scores: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the same where what is known of a channel's parameters depends on those of the others.

        Parameters
        ----------
        vector : ndarray, (n,)
        information : ndarray, (Nfreqs q, Nfreqs q)
            Of all effects, those of a channel side by side.
        scores : ndarray, (Nfreqs, q)
        """
        precision, score = self.prior_precision(), self.prior_score(vector)
        own = [self.of_channel(channel) for channel in range(self.n_freqs)]
        here = np.concatenate([one for one, _ in own])
        among = np.concatenate([channel * scores.shape[1] + one for channel, (_, one) in enumerate(own)])
        np.add.at(precision, (here[:, np.newaxis], here), information[np.ix_(among, among)])
        np.add.at(score, here, scores.ravel()[among])
        return self._solved(precision, score)

    def _solved(self, precision: FloatArray, score: FloatArray) -> tuple[FloatArray, FloatArray]:
        try:
            factor = np.linalg.cholesky(self.free.T @ precision @ self.free)
        except np.linalg.LinAlgError as error:
            names = ", ".join(one.kind for one in self.active)
            raise InputError(
                f"data and prior leave some of the parameters of {names} free, so that they have no posterior",
                field="[sample] blocks",
                remedy="leave out the block, or give its parameters a narrower prior",
            ) from error
        return np.asarray(cho_solve((factor, True), self.free.T @ score)), np.asarray(factor)

    def log_prior(self, values: Values) -> float:
        """Return the logarithm of the prior up to a constant."""
        here = [values.active[place] for place in self.moving]
        return sum(one.prior.log_density(one.x[:, one.used]) for one in here)

    def _n_sets(self, one: Active) -> int:
        return 1 if one.prior.shared else self.n_freqs

    def log_prior_apart(self, values: Values) -> FloatArray:
        """Return the logarithm of the prior of what is of single channels, up to a constant, (Nfreqs,)."""
        total = np.zeros(self.n_freqs)
        for one in (values.active[place] for place in self.moving if self._is_apart(values.active[place])):
            for channels, prior in one.prior.pieces(self.n_freqs):
                away = one.x[channels.start, one.used] - prior.mean
                total[channels.start] -= 0.5 * float(away @ prior.precision_times(away))
        return total

    def over_widths(self, vector: FloatArray) -> tuple[FloatArray, IntArray, IntArray]:
        """Return what is to be known of the entries, (m,) each, of whose prior a width is drawn.

        Squares over the stated variances, numbers of the widths, and the channels that they are of alone, or the number
        of channels.
        """
        which = np.flatnonzero(self.width_of >= 0)
        return (vector[which] / self._stated_std[which]) ** 2, self.width_of[which], self._channel_of[which]

    @cached_property
    def _stated_std(self) -> FloatArray:
        """Standard deviations of the vector's prior, (n,)."""
        pieces = [prior.std() for one in self.active for _, prior in one.prior.pieces(self.n_freqs)]
        return np.concatenate([np.zeros(0), *pieces])

    @cached_property
    def _channel_of(self) -> IntArray:
        """The channel that each entry of the vector is of alone, or the number of channels, (n,)."""
        channels = np.full(self.size, self.n_freqs)
        for one, span in zip(self.active, self.spans, strict=True):
            if self._is_apart(one):
                channels[span] = np.repeat(np.arange(self.n_freqs), one.size)
        return channels

    def log_prior_of_widths(self, values: Values, spreads: FloatArray) -> FloatArray:
        """Return by how much the prior's logarithm changes with variances ``spreads`` times as large.

        (Nfreqs + 1,): by channel, and of what is of several, up to what the effects do not change.
        """
        if not len(spreads):
            return np.zeros(self.n_freqs + 1)
        squares, widths, channels = self.over_widths(self.vector(values))
        return np.asarray(
            np.bincount(channels, 0.5 * squares * (1 - 1 / spreads[widths]), self.n_freqs + 1), dtype=float
        )

    def taken(self, channels: BoolArray, new: FloatArray, old: FloatArray) -> FloatArray:
        """Return the vector with what is of some channels alone, (Nfreqs,), as a new one has it, (n,)."""
        vector = old.copy()
        for one, span in zip(self.active, self.spans, strict=True):
            if self._is_apart(one):
                vector[span][np.repeat(channels, one.size)] = new[span][np.repeat(channels, one.size)]
        return vector

    def _is_apart(self, one: Active) -> bool:
        """Whether an effect's parameters in one channel have nothing to do with those in another."""
        return self.n_freqs > 1 and self.channels_apart and not (one.prior.shared or one.prior.n_coupled)
