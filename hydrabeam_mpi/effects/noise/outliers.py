"""A few rows far from all others, such as residual radio interference: a heavy tail of |z|^2."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field
from scipy.special import bdtrc

from hydrabeam_mpi.data.observation import BoolArray, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.reweighting import Reweighting, ReweightingFit, fitted_counts
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.effects.noise.heavy_tail import EDGES, MAX_FRACTION, MIN_GAIN, fit_mixture
from hydrabeam_mpi.inference.robust import LOG_MEAN
from hydrabeam_mpi.random import complex_normal

Level = Annotated[float, Field(ge=1)]
# Rows beyond this stand out; noise has 1.4e-11 of its rows there.
HIT = 25.0
# Rows beyond this are counted by baseline; noise has 3e-7 of its rows there.
LARGE = 15.0
# Large rows of one baseline, that many at least, gather if they are no likelier than this by chance.
GATHERED = 3
GATHERED_P = 1e-6
# Hits this many standard deviations above the mean in ln |m|^2 w, or whose size correlates this well with it, are the
# model's errors, not bursts.
BRIGHTER = 1.0
CORRELATION = 0.5
N_MOMENTS = 9
MIN_HITS = 10
# Fewer baselines than this at a time have no majority.
MIN_BASELINES = 4


class Outliers(Reweighting):
    """Rows to leave out: those with |z|^2 beyond a threshold, and whole times where most baselines are.

    The parameters of a channel are the threshold of |z|^2, and the fraction of rows hit with the scale of their |z|^2.
    The threshold is chosen so that in the mean less than 0.01 of all good rows are lost.

    While something else is missing, residuals are larger than noise: those of each baseline by a level of its own, as
    gains and sources make them. Bursts are then told from the other times of their baseline, with |z|^2 in units of
    its level.

    Parameters
    ----------
    levels : sequence, (Nfreqs, Nbls), optional
        Variance of most of the whitened residuals of each baseline; none where they are noise.
    """

    kind = "outliers"
    title = "outliers"
    searched_again_with_heavy_tails = True
    leaves_out = True

    def __init__(self, levels: Sequence[Sequence[Level]] = ()) -> None:
        self.levels: FloatArray = np.array(levels, dtype=float)

    @property
    def at_own_level(self) -> bool:
        """Whether residuals have levels."""
        return self.levels.size > 0

    def at_levels(self, levels: FloatArray) -> Self:
        """Return outliers beside residuals that have these variances, (Nfreqs, Nbls)."""
        return type(self)(levels.tolist())

    @property
    def beside_noise(self) -> Self:
        """Outliers of residuals without levels."""
        return type(self)()

    def describe(self) -> dict[str, Any]:
        """Return the levels, if there are any."""
        return {"levels": self.levels.tolist()} if self.at_own_level else {}

    def sizes(self, setup: ObservingSetup) -> tuple[int, ...]:
        """Return three: threshold, fraction and scale."""
        return (3,)

    def neutral(self, setup: ObservingSetup) -> dict[str, float]:
        """Return no hits."""
        return {"largest |z|^2 kept": HIT, "fraction of rows hit": 0.0, "scale of |z|^2 where hit": 1.0}

    def n_sums(self, setup: ObservingSetup) -> int:
        """Return the number of bins, of logs by baseline, of counts by time and by baseline, and of moments."""
        observation = setup.observation
        return len(EDGES) - 1 + observation.Nbls + 2 * (observation.Ntimes + observation.Nbls) + N_MOMENTS

    def sums(self, block: RowBlock, z: ComplexArray) -> FloatArray:
        """Return sums of |z|^2 in units of its level, (n_sums,).

        These are: the histogram; sums of ln |z|^2 by baseline; rows and hits by time; rows and large ones by baseline;
        moments. Those are sums of 1, a and a^2 with a = ln |m|^2 w, the model's, over all rows, and of 1, a, a^2, b,
        b^2 and a b with b = ln |z|^2 over those that are hit.
        """
        observation = block.setup.observation
        used = block.weights > 0
        u = np.abs(z) ** 2 / self._level(block.channel, block.bls)
        hit = used & (u > HIT)
        counts = np.histogram(np.minimum(u[used], EDGES[-2]), EDGES)[0]
        by_time, by_bl = np.zeros((2, observation.Ntimes)), np.zeros((2, observation.Nbls))
        by_time[:, block.times] = used.sum(axis=1), hit.sum(axis=1)
        by_bl[:, block.bls] = used.sum(axis=0), (used & (u > LARGE)).sum(axis=0)
        logs = np.zeros(observation.Nbls)
        logs[block.bls] = np.sum(np.log(np.where(used & (u > 0), u, 1.0)), axis=0)
        bright = used & (block.vis != 0)
        model = np.log(np.abs(block.vis[bright]) ** 2 * block.weights[bright])
        of_hits, size = model[hit[bright]], np.log(u[bright & hit])
        moments = [len(model), model.sum(), model @ model, len(size), of_hits.sum(), of_hits @ of_hits]
        moments += [size.sum(), size @ size, of_hits @ size]
        return np.concatenate([counts, logs, by_time.reshape(-1), by_bl.reshape(-1), moments])

    def fit(self, setup: ObservingSetup, sums: FloatArray, effective_parameters: FloatArray) -> ReweightingFit:
        """Weigh the mixture against noise alone, with ``sums`` (Nfreqs, n_sums); see `Reweighting.fit`."""
        n_bins, n_bls = len(EDGES) - 1, setup.observation.Nbls
        fits, reasons, levels = [], [], []
        for of_channel, taken in zip(sums, effective_parameters, strict=True):
            rows = of_channel[-N_MOMENTS - 2 * n_bls : -N_MOMENTS - n_bls]
            bulk = 1.0 if self.at_own_level else float(fitted_counts(rows, taken).sum() / max(rows.sum(), 1.0))
            fitted = fit_mixture(of_channel[:n_bins], bulk)
            fits.append(fitted)
            levels.append(_levels(of_channel[n_bins : n_bins + n_bls], rows))
            if fitted.gain > MIN_GAIN:
                reasons.append(_not_bursts(setup, of_channel[n_bins + n_bls :]) or fitted.reason)
        refused = [reason for reason in reasons if reason]
        evidence = float(sum(one.log_bayes_factor for one in fits))
        return ReweightingFit(
            log_bayes_factor=min(evidence, 0.0) if refused else evidence,
            x=np.array([one.x for one in fits]),
            std=np.array([one.std for one in fits]),
            names=tuple(self.neutral(setup)),
            units=("", "", ""),
            chi2_drop=float(2 * sum(one.gain for one in fits)),
            n_parameters=2 * len(fits),
            reason=refused[0] if refused else None,
            levels=None if self.at_own_level else np.array(levels),
        )

    def weight_factor(self, block: RowBlock, x: FloatArray) -> FloatArray:
        """Return zero for rows beyond the threshold by the block's residuals, and for times where most are; else one.

        The result is (Ntimes, Nbls).

        A time is judged by the block's own baselines.
        """
        used = block.weights > 0
        beyond = used & (np.abs(block.residual) ** 2 * block.weights > x[0] * self._level(block.channel, block.bls))
        return np.where(beyond | mostly(beyond.sum(axis=1), used.sum(axis=1))[:, np.newaxis], 0.0, 1.0)

    def price(self, setup: ObservingSetup, channel: int, times: IntArray, bls: IntArray, x: FloatArray) -> FloatArray:
        """Return the threshold of each baseline, (Ntimes, Nbls); see `Reweighting.price`."""
        return np.broadcast_to(x[0] * self._level(channel, bls), (len(times), len(bls)))

    def _level(self, channel: int, bls: IntArray) -> FloatArray:
        """Return the variance of most of the whitened residuals of some baselines, (Nbls,)."""
        return self.levels[channel, bls] if self.at_own_level else np.ones(len(bls))

    def draw(self, setup: ObservingSetup, rng: np.random.Generator, strength: float) -> FloatArray:
        """Draw bursts in a tenth of ``strength`` of the rows, 5% at most, of a power between 100 and 10,000.

        The result is (n_params,).
        """
        return np.array([HIT, min(0.1 * strength, MAX_FRACTION), 10 ** rng.uniform(2, 4)])

    def inject(self, data: ComplexArray, block: RowBlock, x: FloatArray, rng: np.random.Generator) -> ComplexArray:
        """Add bursts to a fraction ``x[1]`` of the rows, of the scale ``x[2]`` in |z|^2, (Ntimes, Nbls)."""
        chosen = (rng.random(block.shape) < x[1]) & (block.weights > 0)
        burst = complex_normal(rng, block.shape) * np.sqrt(x[2] / rng.standard_exponential(block.shape))
        sigma = np.sqrt(np.where(chosen, 1 / np.where(chosen, block.weights, 1.0), 0.0))
        return data + burst * sigma


def _levels(logs: FloatArray, rows: FloatArray) -> FloatArray:
    """Return the variance of most of each baseline's whitened residuals, noise at least, from the mean of ln |z|^2.

    A mean of logs feels few wild rows little. Baselines of which no row is fitted have the mean level of all.
    """
    has = rows > 0
    means = np.where(has, logs / np.where(has, rows, 1.0), logs.sum() / max(rows.sum(), 1.0))
    return np.asarray(np.maximum(np.exp(means - LOG_MEAN), 1.0))


def mostly(hits: FloatArray, rows: FloatArray) -> BoolArray:
    """Tell where hits are the majority of rows, and these are enough to say so; all are of one shape, (N,)."""
    return np.asarray((rows >= MIN_BASELINES) & (2 * hits > rows))


def _not_bursts(setup: ObservingSetup, counts: FloatArray) -> str | None:
    """Say why rows that stand out are not bursts, from the counts behind the histogram; None where they may be."""
    n_times, n_bls = setup.observation.Ntimes, setup.observation.Nbls
    time_rows, time_hits = counts[: 2 * n_times].reshape(2, n_times)
    rows, large = counts[2 * n_times : -N_MOMENTS].reshape(2, n_bls)
    by_chance = bdtrc(large - 1, int(large.sum()), rows / max(rows.sum(), 1.0)) * n_bls
    gathered = (large >= GATHERED) & (by_chance < GATHERED_P)
    if 2 * large[gathered].sum() > large.sum():
        return f"they gather on {gathered.sum()} baseline(s)"
    whole_times = time_hits[mostly(time_hits, time_rows)].sum()
    if _follow_model(counts[-N_MOMENTS:], scattered=bool(2 * whole_times < time_hits.sum())):
        return "they are where the model is bright, as errors of the model are"
    return None


def _follow_model(moments: FloatArray, scattered: bool) -> bool:
    """Tell whether hits prefer rows where the model is bright, or are larger there.

    ``scattered`` hits are free to choose their rows; those that come by whole times have the model's power of these.
    """
    number, model, model2 = moments[:3]
    hits, of_hits, of_hits2, size, size2, product = moments[3:]
    if hits < MIN_HITS:
        return False
    mean, spread = model / number, np.sqrt(max(model2 / number - (model / number) ** 2, 1e-12))
    brighter = of_hits / hits - mean > BRIGHTER * spread
    variances = (of_hits2 / hits - (of_hits / hits) ** 2) * (size2 / hits - (size / hits) ** 2)
    correlation = (product / hits - of_hits * size / hits**2) / np.sqrt(max(variances, 1e-12))
    return bool((scattered and brighter) or (correlation > CORRELATION and correlation * np.sqrt(hits) > 4))
