"""Parts of the data that stand out from all others of their sort, with something else in them, and are left out.

Parts are integrations, or baselines. With Q the sum of |z|^2 over the rows of a part and n their number, noise of
variance s^2 in place of one gains

    ln L = Q - n - n ln(Q/n)    at    s^2 = Q/n,

fitted and held-out rows together, less what the freedom of s costs and which parts they are. What any effect explains
it explains better: that leaves noise, and gains Q - n. So bad parts compete with effects by evidence. They do not
count: their noise is that of something else, which says nothing of the beam.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import numpy as np
from scipy.special import expit, gammaln

from hydrabeam_mpi.data.observation import BoolArray, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.reweighting import Reweighting, ReweightingFit, with_more_noise
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.inference.robust import GAUSSIAN, LOG_MEAN, LOG_STD, MOST_EXCEPTIONS, STRONG, beside_median

LARGEST = 1e5
"""Noise scale up to which the prior of its logarithm is flat. Ten times as much costs 0.2 nats a part."""
STEPS = 50
"""Of expectation and maximisation, which converge within some ten where few are of another kind."""
MOST_DRAWN = 0.1
"""Of all parts, how many are drawn at most."""


class Sums(NamedTuple):
    """Of each part: how many rows, and their sums of ln |z|^2 less its mean for noise, and of |z|^2.

    All are (Nfreqs, 2, Nparts), of fitted and of held-out rows.
    """

    numbers: FloatArray
    logs: FloatArray
    powers: FloatArray

    def without(self, parts: BoolArray) -> Sums:
        """Return the same with nothing of some parts of each channel, (Nfreqs, Nparts)."""
        return Sums(*(np.where(parts[:, np.newaxis], 0.0, one) for one in self))


class Choice(NamedTuple):
    """Which parts may be bad, (Nfreqs, Nparts), ln of the number of such choices, and whether those are too many."""

    bad: BoolArray
    log_choices: FloatArray
    many: bool


class StandingOut(Reweighting):
    """Parts of the data to leave out, as they stand out from all others.

    The parameters of a channel are the noise scales of all parts: one for those that are as they should be.
    """

    leaves_out = True
    weighs_heldout = True
    parts: ClassVar[str]
    """What they are, in words."""
    n_further: ClassVar[int] = 0
    """How many `further` sums a part has."""

    @property
    def at_own_level(self) -> bool:
        """Yes: they stand out from the others, whatever these are."""
        return True

    @abstractmethod
    def looked_at(self, setup: ObservingSetup) -> IntArray:
        """Return the numbers of the parts that have parameters, ascending, (n_params,)."""

    @abstractmethod
    def by_part(self, setup: ObservingSetup, times: IntArray, bls: IntArray, rows: FloatArray) -> FloatArray:
        """Add up something of rows, (Ntimes, Nbls), by part, (Nparts,) with those that are not looked at."""

    @abstractmethod
    def scales(self, setup: ObservingSetup, times: IntArray, bls: IntArray, x: FloatArray) -> FloatArray:
        """Return the noise scales of rows by the parameters, (n_params,), to be broadcast to (Ntimes, Nbls)."""

    def further(self, setup: ObservingSetup, times: IntArray, bls: IntArray, z: ComplexArray) -> list[FloatArray]:
        """Return more sums by part, `n_further` of (Nparts,), of whitened rows, (Ntimes, Nbls), zero where none are."""
        return []

    def choices(self, setup: ObservingSetup, sums: Sums, further: FloatArray) -> Sequence[Choice]:
        """Return which of the parts that are looked at may be bad, in one way or another.

        Of these are the `Sums` and the `further` sums, (n_further, Nfreqs, 2, Nparts), of fitted and of held-out rows.
        """
        return [choose(sums)]

    def is_told(self, x: FloatArray) -> BoolArray:
        """Return which parts are bad in any channel, (n_params,)."""
        return np.asarray((x > 1).any(axis=0))

    def sizes(self, setup: ObservingSetup) -> tuple[int, ...]:
        """Return the number of parts that are looked at."""
        return (len(self.looked_at(setup)),)

    def n_sums(self, setup: ObservingSetup) -> int:
        """Return how many there are: of fitted and of held-out rows, numbers, logarithms, powers and further ones."""
        nothing = np.zeros(0, dtype=int)
        return 2 * self._n_by_part * len(self.by_part(setup, nothing, nothing, np.zeros((0, 0))))

    @property
    def _n_by_part(self) -> int:
        return len(Sums._fields) + self.n_further

    def sums(self, block: RowBlock, z: ComplexArray) -> FloatArray:
        """Return by part how many rows there are, the sums of ln |z|^2 and of |z|^2, and further ones, (n_sums,)."""
        found = self._sums(block.setup, block.times, block.bls, z)
        return np.concatenate([found, np.zeros_like(found)])

    def heldout_sums(self, setup: ObservingSetup, times: IntArray, bls: IntArray, z: ComplexArray) -> FloatArray:
        """Return the same of held-out rows, (n_sums,)."""
        found = self._sums(setup, times, bls, z)
        return np.concatenate([np.zeros_like(found), found])

    def _sums(self, setup: ObservingSetup, times: IntArray, bls: IntArray, z: ComplexArray) -> FloatArray:
        """Return numbers, sums of ln |z|^2 less its mean for noise, of |z|^2, and others; no row where z is zero."""
        known = z != 0
        power = np.where(known, np.abs(z) ** 2, 1.0)
        each = known.astype(float), np.where(known, np.log(power) - LOG_MEAN, 0.0), np.where(known, power, 0.0)
        by_part = [self.by_part(setup, times, bls, rows) for rows in each]
        return np.concatenate([*by_part, *self.further(setup, times, bls, z)])

    def fit(self, setup: ObservingSetup, sums: FloatArray, effective_parameters: FloatArray) -> ReweightingFit:
        """Find the parts that stand out and weigh them, with ``sums`` (Nfreqs, n_sums)."""
        each = sums.reshape(len(sums), 2, self._n_by_part, -1).transpose(2, 0, 1, 3)[..., self.looked_at(setup)]
        by_part, further = Sums(*each[: len(Sums._fields)]), each[len(Sums._fields) :]
        found = [self._weighed(setup, by_part, choice) for choice in self.choices(setup, by_part, further)]
        return max(found, key=lambda one: one.log_bayes_factor)

    def _weighed(self, setup: ObservingSetup, sums: Sums, choice: Choice) -> ReweightingFit:
        """Weigh bad parts: their noise scales, at the price of their freedom and of which they are."""
        names, rows = tuple(self.neutral(setup)), np.maximum(sums.numbers.sum(axis=1), 1)
        ratio = sums.powers.sum(axis=1) / rows
        bad = choice.bad & (ratio > 1)
        variance = np.where(bad, ratio, 1.0)[:, np.newaxis]
        of_fitted, of_heldout = (sums.powers * (1 - 1 / variance) - sums.numbers * np.log(variance)).sum(axis=(0, 2))
        gain = of_fitted + of_heldout
        freedom = np.where(bad, np.log(np.sqrt(2 * np.pi / rows) / (2 * np.log(LARGEST))), 0.0).sum()
        cost = choice.log_choices[bad.any(axis=1)].sum() - freedom
        most = 0.0 if choice.many else np.inf
        scales = np.where(bad, np.sqrt(ratio), 1.0)
        many = f"more than {MOST_EXCEPTIONS:.0%} of the {self.parts} stand out, which are not a few"
        return ReweightingFit(
            log_bayes_factor=float(min(gain - cost, most)),
            x=scales,
            std=np.where(bad, 0.5 * scales / np.sqrt(rows), 0.0),
            names=names,
            units=("",) * len(names),
            chi2_drop=float(2 * gain),
            n_parameters=int(np.count_nonzero(bad)),
            of_fitted=float(min(of_fitted - cost, most)),
            reason=many if choice.many else None,
        )

    def weight_factor(self, block: RowBlock, x: FloatArray) -> FloatArray:
        """Return zero where parts are bad, one elsewhere, (Ntimes, Nbls)."""
        scales = self.scales(block.setup, block.times, block.bls, x)
        return np.broadcast_to(np.where(scales > 1, 0.0, 1.0), block.shape)

    def price(self, setup: ObservingSetup, channel: int, times: IntArray, bls: IntArray, x: FloatArray) -> FloatArray:
        """Return 1 + ln s^2 where parts are bad: minus the mean ln density of noise so large, (Ntimes, Nbls)."""
        scales = self.scales(setup, times, bls, x)
        return np.broadcast_to(np.where(scales > 1, 1 + 2 * np.log(scales), np.inf), (len(times), len(bls)))

    def draw(self, setup: ObservingSetup, rng: np.random.Generator, strength: float) -> FloatArray:
        """Draw a tenth of the parts at most, larger by ``strength`` rms, (n_params,)."""
        (n_parts,) = self.sizes(setup)
        chosen = rng.choice(n_parts, max(int(MOST_DRAWN * n_parts), 1), replace=False)
        x = np.ones(n_parts)
        x[chosen] += strength * np.abs(rng.standard_normal(len(chosen)))
        return x

    def inject(self, data: ComplexArray, block: RowBlock, x: FloatArray, rng: np.random.Generator) -> ComplexArray:
        """Add noise of variance (s^2 - 1) sigma^2 to bad parts, (Ntimes, Nbls)."""
        scales = np.broadcast_to(self.scales(block.setup, block.times, block.bls, x), block.shape)
        return with_more_noise(data, block, scales**2 - 1, rng)


def choose(sums: Sums) -> Choice:
    """Return the parts that stand out from most in any channel, and how many such choices there are."""
    bad = _stand_out(sums.logs, sums.powers, sums.numbers)
    bad &= sums.powers.sum(axis=1) > sums.numbers.sum(axis=1)
    n_parts, n_bad = np.count_nonzero(sums.numbers.any(axis=1), axis=1), np.count_nonzero(bad, axis=1)
    return Choice(bad, _log_choices(n_parts, n_bad), bool(np.any(n_bad > MOST_EXCEPTIONS * n_parts)))


def _stand_out(logs: FloatArray, power: FloatArray, n: FloatArray) -> BoolArray:
    """Return which parts of which channels are of another kind than most, (Nfreqs, Nparts).

    Those are for which the odds are `STRONG`, in a channel by itself or in all of those together in which they are not.
    A part is as likely bad in all channels as in a few, where it is bad at all.

    Parameters
    ----------
    logs, power, n : ndarray, (Nfreqs, 2, Nparts)
        Sums of ln |z|^2, of |z|^2, and of how many rows: fitted and held-out ones, each beside their median.
    """
    each = [_beside_most(*of_channel) for of_channel in zip(logs, power, n, strict=True)]
    ratios = np.array([one.log_ratios for one in each])
    prior = np.array([[np.log(one.share / (1 - one.share))] for one in each])
    own = ratios + prior > STRONG
    known, n_parts = n.any(axis=1), max(int(np.count_nonzero(n.any(axis=(0, 1)))), 1)
    rest = known & ~own
    together = np.where(rest, ratios, 0.0).sum(axis=0)
    n_bad = max(int(np.count_nonzero(own.any(axis=0))), 1)
    share = min(n_bad / (n_parts + 1), MOST_EXCEPTIONS)
    together += np.where(own.any(axis=0), 0.0, np.log(share / (1 - share)))
    return own | (rest & (known.sum(axis=0) > 1) & (together > STRONG))


class _BesideMost(NamedTuple):
    """Ln of how much likelier each part is of another kind than of that of most, (Nparts,), and the share of such."""

    log_ratios: FloatArray
    share: float


def _beside_most(logs: FloatArray, power: FloatArray, n: FloatArray) -> _BesideMost:
    """Compare the parts of a channel with most of them, by its sums, (2, Nparts) each.

    The mean logs of most have a Gaussian distribution, whatever its width, wider by the error of each, and so has the
    log of their power, of which the error is less; those of a few, `MOST_EXCEPTIONS` at most, are anywhere above its
    middle, up to `LARGEST`. Width and share are those of the greatest likelihood, found by expectation and
    maximisation. But a few wild rows have a power, too: where all rows have more noise, their mean log is that of their
    power, and where a few are wild it is that of most parts. What counts is the lesser of both ratios.
    """
    rows = n.sum(axis=0)
    known = rows > 0
    ratios = np.full(len(known), -np.inf)
    if not known.any():
        return _BesideMost(ratios, 0.5)
    rows = rows[known]
    at, size = (_beside_median(means, n)[known] for means in (means_of(logs, n), np.log(means_of(power, n))))
    error2, width2 = LOG_STD**2 / rows, (GAUSSIAN * float(np.median(np.abs(at)))) ** 2
    middle, share, last = 0.0, 1 / (len(at) + 1), 0.0
    log_broad = -np.log(2 * np.log(LARGEST))
    for _ in range(STEPS):
        of_all = log_broad - _log_gauss(size, width2 + 1 / rows)
        not_of_few = _log_gauss(at - middle - size, error2) - _log_gauss(at - middle, width2 + error2)
        log_ratios = np.where((at > middle) & (size > 0), np.minimum(of_all, not_of_few), -np.inf)
        last = share
        usual = expit(-log_ratios - np.log(share / (1 - share)))
        middle = float(np.average(at, weights=usual))
        width2 = max(float(np.average((at - middle) ** 2 - error2, weights=usual)), 0.0)
        share = float(np.clip(1 - usual.mean(), 1 / (len(at) + 1), MOST_EXCEPTIONS))
    ratios[known] = log_ratios
    return _BesideMost(ratios, last)


def means_of(total: FloatArray, n: FloatArray) -> FloatArray:
    """Return means by their sums and numbers; NaN where there is nothing."""
    return np.divide(total, n, out=np.full(n.shape, np.nan), where=n > 0)


def _beside_median(means: FloatArray, n: FloatArray) -> FloatArray:
    """Return the means of all rows of each part, (Nparts,), fitted and held-out ones each beside their median."""
    beside = np.where(n > 0, beside_median(means), 0.0)
    return np.asarray(np.sum(n * beside, axis=0) / np.maximum(n.sum(axis=0), 1))


def _log_gauss(x: FloatArray, variance: FloatArray) -> FloatArray:
    return np.asarray(-0.5 * (x**2 / variance + np.log(2 * np.pi * variance)))


def _log_choices(n: IntArray, k: IntArray) -> FloatArray:
    """Return ln of the number of ways to choose k of n."""
    return np.asarray(gammaln(n + 1) - gammaln(k + 1) - gammaln(n - k + 1))
