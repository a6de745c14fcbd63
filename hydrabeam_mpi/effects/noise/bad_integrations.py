"""A few integrations with something else on all baselines, such as interference: each has a noise scale of its own.

With Q the sum of |z|^2 over the rows of an integration and n their number, noise of variance s^2 in place of one gains

    ln L = Q - n - n ln(Q/n)    at    s^2 = Q/n,

fitted and held-out rows together, less what the freedom of s costs and which integrations they are. What any effect
explains it explains better: that leaves noise, and gains Q - n. So bad integrations compete with effects by evidence.
Those that are bad do not count: their noise is that of something else, which says nothing of the beam.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import expit, gammaln

from hydrabeam_mpi.data.observation import BoolArray, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.reweighting import Reweighting, ReweightingFit, with_more_noise
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.inference.robust import GAUSSIAN, LOG_MEAN, LOG_STD, MOST_EXCEPTIONS, STRONG, beside_median

LARGEST = 1e5
"""Noise scale up to which the prior of its logarithm is flat. Ten times as much costs 0.2 nats an integration."""
STEPS = 50
"""Of expectation and maximisation, which converge within some ten where few are of another kind."""
MANY = f"more than {MOST_EXCEPTIONS:.0%} of the integrations stand out, which are not a few"
MOST_DRAWN = 0.1
"""Of all integrations, how many are drawn at most."""


class BadIntegrations(Reweighting):
    """Integrations to leave out, as they stand out from all others of the data.

    The parameters of a channel are the noise scales of all integrations: one for those that are as they should be.
    """

    kind = "bad_integrations"
    title = "bad integrations"
    leaves_out = True
    weighs_heldout = True

    @property
    def at_own_level(self) -> bool:
        """Yes: they stand out from the others, whatever these are."""
        return True

    def is_told(self, x: FloatArray) -> BoolArray:
        """Return which integrations are bad in any channel, (n_params,)."""
        return np.asarray((x > 1).any(axis=0))

    def sizes(self, setup: ObservingSetup) -> tuple[int, ...]:
        """Return the number of times that are looked at."""
        return (len(setup.times),)

    def neutral(self, setup: ObservingSetup) -> dict[str, float]:
        """Return ones."""
        return dict.fromkeys((f"JD {jd:.6f} noise scale" for jd in setup.observation.times[setup.times]), 1.0)

    def n_sums(self, setup: ObservingSetup) -> int:
        """Return 6 Ntimes: of fitted and of held-out rows, numbers, logarithms and powers."""
        return 6 * setup.observation.Ntimes

    def sums(self, block: RowBlock, z: ComplexArray) -> FloatArray:
        """Return by time how many rows there are and the sums of ln |z|^2 and of |z|^2, (n_sums,)."""
        return np.concatenate([_by_time(block.setup, block.times, z), np.zeros(3 * block.setup.observation.Ntimes)])

    def heldout_sums(self, setup: ObservingSetup, times: IntArray, z: ComplexArray) -> FloatArray:
        """Return the same of held-out rows, (n_sums,)."""
        return np.concatenate([np.zeros(3 * setup.observation.Ntimes), _by_time(setup, times, z)])

    def fit(self, setup: ObservingSetup, sums: FloatArray, effective_parameters: FloatArray) -> ReweightingFit:
        """Find the integrations that stand out and weigh them, with ``sums`` (Nfreqs, n_sums)."""
        by_time = sums.reshape(len(sums), 2, 3, -1)[..., setup.times]
        numbers, logs, powers = by_time.transpose(2, 0, 1, 3)
        bad = _stand_out(logs, powers, numbers)
        found = [_fit_channel(*of_channel) for of_channel in zip(numbers, powers, bad, strict=True)]
        evidence, names = float(sum(one.log_bayes_factor for one in found)), tuple(self.neutral(setup))
        many = any(one.many for one in found)
        return ReweightingFit(
            log_bayes_factor=min(evidence, 0.0) if many else evidence,
            x=np.array([one.scales for one in found]),
            std=np.array([one.std for one in found]),
            names=names,
            units=("",) * len(names),
            chi2_drop=float(2 * sum(one.gain for one in found)),
            n_parameters=sum(int(np.count_nonzero(one.std)) for one in found),
            reason=MANY if many else None,
        )

    def weight_factor(self, block: RowBlock, x: FloatArray) -> FloatArray:
        """Return zero at bad integrations, one elsewhere, (Ntimes, Nbls)."""
        return np.broadcast_to(np.where(_scales(block.setup, block.times, x) > 1, 0.0, 1.0), block.shape)

    def price(self, setup: ObservingSetup, channel: int, times: IntArray, bls: IntArray, x: FloatArray) -> FloatArray:
        """Return 1 + ln s^2 at bad integrations: minus the mean ln density of noise so large, (Ntimes, Nbls)."""
        scales = _scales(setup, times, x)
        price = np.where(scales > 1, 1 + 2 * np.log(scales), np.inf)
        return np.broadcast_to(price, (len(times), len(bls)))

    def draw(self, setup: ObservingSetup, rng: np.random.Generator, strength: float) -> FloatArray:
        """Draw a tenth of the integrations at most, larger by ``strength`` rms, (n_params,)."""
        n_times = len(setup.times)
        chosen = rng.choice(n_times, max(int(MOST_DRAWN * n_times), 1), replace=False)
        x = np.ones(n_times)
        x[chosen] += strength * np.abs(rng.standard_normal(len(chosen)))
        return x

    def inject(self, data: ComplexArray, block: RowBlock, x: FloatArray, rng: np.random.Generator) -> ComplexArray:
        """Add noise of variance (s^2 - 1) sigma^2 to bad integrations, (Ntimes, Nbls)."""
        return with_more_noise(data, block, _scales(block.setup, block.times, x) ** 2 - 1, rng)


class _Found(NamedTuple):
    """Of one channel: scales with errors, (Ntimes,), ln Bayes factor, gain in ln L, and whether they are too many."""

    scales: FloatArray
    std: FloatArray
    log_bayes_factor: float
    gain: float
    many: bool


def _fit_channel(n: FloatArray, power: FloatArray, stand_out: BoolArray) -> _Found:
    """Weigh the bad integrations of a channel, (Ntimes,), from its sums, (2, Ntimes) each."""
    rows = np.maximum(n.sum(axis=0), 1)
    ratio = power.sum(axis=0) / rows
    bad = stand_out & (ratio > 1)
    scales = np.where(bad, np.sqrt(ratio), 1.0)
    gain = (rows * (ratio - 1 - np.log(np.maximum(ratio, 1))))[bad].sum()
    freedom = np.log(np.sqrt(2 * np.pi / rows[bad]) / (2 * np.log(LARGEST))).sum()
    n_times, n_bad = int(np.count_nonzero(n.any(axis=0))), int(np.count_nonzero(bad))
    evidence = float(gain + freedom) - _log_choices(n_times, n_bad)
    std = np.where(bad, 0.5 * scales / np.sqrt(rows), 0.0)
    return _Found(scales, std, evidence, float(gain), n_bad > MOST_EXCEPTIONS * n_times)


def _stand_out(logs: FloatArray, power: FloatArray, n: FloatArray) -> BoolArray:
    """Return which times of which channels are of another kind than most, (Nfreqs, Ntimes).

    Those are for which the odds are `STRONG`, in a channel by itself or in all of those together in which they are not.
    A time is as likely bad in all channels as in a few, where it is bad at all.

    Parameters
    ----------
    logs, power, n : ndarray, (Nfreqs, 2, Ntimes)
        Sums of ln |z|^2, of |z|^2, and of how many rows: fitted and held-out ones, each beside their median.
    """
    each = [_beside_most(*of_channel) for of_channel in zip(logs, power, n, strict=True)]
    ratios = np.array([one.log_ratios for one in each])
    prior = np.array([[np.log(one.share / (1 - one.share))] for one in each])
    own = ratios + prior > STRONG
    known, n_times = n.any(axis=1), max(int(np.count_nonzero(n.any(axis=(0, 1)))), 1)
    rest = known & ~own
    together = np.where(rest, ratios, 0.0).sum(axis=0)
    n_bad = max(int(np.count_nonzero(own.any(axis=0))), 1)
    share = min(n_bad / (n_times + 1), MOST_EXCEPTIONS)
    together += np.where(own.any(axis=0), 0.0, np.log(share / (1 - share)))
    return own | (rest & (known.sum(axis=0) > 1) & (together > STRONG))


class _BesideMost(NamedTuple):
    """Ln of how much likelier each time is of another kind than of that of most, (Ntimes,), and the share of such."""

    log_ratios: FloatArray
    share: float


def _beside_most(logs: FloatArray, power: FloatArray, n: FloatArray) -> _BesideMost:
    """Compare the times of a channel with most of them, by its sums, (2, Ntimes) each.

    The mean logs of most have a Gaussian distribution, whatever its width, wider by the error of each, and so has the
    log of their power, of which the error is less; those of a few, `MOST_EXCEPTIONS` at most, are anywhere above its
    middle, up to `LARGEST`. Width and share are those of the greatest likelihood, found by expectation and
    maximisation. But a few wild rows have a power, too: where all rows have more noise, their mean log is that of their
    power, and where a few are wild it is that of most times. What counts is the lesser of both ratios.
    """
    rows = n.sum(axis=0)
    known = rows > 0
    ratios = np.full(len(known), -np.inf)
    if not known.any():
        return _BesideMost(ratios, 0.5)
    rows = rows[known]
    at, size = (_beside_median(means, n)[known] for means in (_mean(logs, n), np.log(_mean(power, n))))
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


def _mean(total: FloatArray, n: FloatArray) -> FloatArray:
    """Return means by their sums and numbers; NaN where there is nothing."""
    return np.divide(total, n, out=np.full(n.shape, np.nan), where=n > 0)


def _beside_median(means: FloatArray, n: FloatArray) -> FloatArray:
    """Return the means of all rows of each time, (Ntimes,), fitted and held-out ones each beside their median."""
    beside = np.where(n > 0, beside_median(means), 0.0)
    return np.asarray(np.sum(n * beside, axis=0) / np.maximum(n.sum(axis=0), 1))


def _log_gauss(x: FloatArray, variance: FloatArray) -> FloatArray:
    return np.asarray(-0.5 * (x**2 / variance + np.log(2 * np.pi * variance)))


def _by_time(setup: ObservingSetup, times: IntArray, z: ComplexArray) -> FloatArray:
    """Return numbers, sums of ln |z|^2 less its mean for noise, and of |z|^2, (3 Ntimes,); no row where z is zero."""
    known = z != 0
    power = np.where(known, np.abs(z) ** 2, 1.0)
    out = np.zeros((3, setup.observation.Ntimes))
    for row, values in enumerate((known, np.where(known, np.log(power) - LOG_MEAN, 0.0), np.where(known, power, 0.0))):
        out[row, times] = values.sum(axis=1)
    return out.ravel()


def _scales(setup: ObservingSetup, times: IntArray, x: FloatArray) -> FloatArray:
    """Return the noise scales of some times, to be broadcast over baselines, (Ntimes, 1)."""
    return x[np.searchsorted(setup.times, times)][:, np.newaxis]


def _log_choices(n: int, k: int) -> float:
    """Return ln of the number of ways to choose k of n."""
    return float(gammaln(n + 1) - gammaln(k + 1) - gammaln(n - k + 1))
