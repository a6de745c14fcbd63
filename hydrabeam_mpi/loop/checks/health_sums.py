"""Data beside the visibilities of the model beam, at all times: what `health` looks at, and sums of it over ranks."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydrabeam_mpi.data.observation import BoolArray, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.data.partition import Tile
from hydrabeam_mpi.fit.rows import Rows, read_rows
from hydrabeam_mpi.inference.robust import LOG_MEAN
from hydrabeam_mpi.io.noise import amid_neighbours
from hydrabeam_mpi.io.uvdata import Block, read_autos
from hydrabeam_mpi.loop.checks.brightest import brightest_source
from hydrabeam_mpi.loop.checks.partner_means import partner_means
from hydrabeam_mpi.model.tabulated import from_table
from hydrabeam_mpi.mpi import ProcessGrid, allreduce_sum, together
from hydrabeam_mpi.setup.problem import Problem

MOST_SAMPLES = 4_000_000
"""Samples looked at, which on a single rank is 200 MB: of more, evenly spread baselines are chosen."""
SECOND = np.array([1.0, -2.0, 1.0])
STILL = 0.1
"""Of the noise's power: sky that moves by less between neighbouring times leaves their differences to the noise."""
PER_DAY = 86400.0


@dataclass(frozen=True)
class Sample:
    """A rank's samples, of fitted and held-out rows alike.

    Attributes
    ----------
    channels : ndarray of int, (Nlocal,)
        Of all the job's channels.
    times : ndarray of int, (Ntimes,)
    bls : ndarray of int, (Nbls,)
    data, model : ndarray of complex, (Nlocal, Ntimes, Nbls)
        Jy, in the sense of redundant groups.
    weights : ndarray, (Nlocal, Ntimes, Nbls)
        Inverse noise variance; zero where flagged.
    autos : ndarray, (Nlocal, Ntimes, Nants)
        Autocorrelations that weights are made of; NaN where there are none.
    """

    channels: IntArray
    times: IntArray
    bls: IntArray
    data: ComplexArray
    model: ComplexArray
    weights: FloatArray
    autos: FloatArray

    def rows(self, problem: Problem, kept: BoolArray) -> Rows:
        """Return the rows of some of the baselines, (Nbls,)."""
        bls, weights = self.bls[kept], self.weights[..., kept]
        groups, member = np.unique(problem.redundant.group[bls], return_inverse=True)
        return Rows(
            Tile(self.times, bls), self.data[..., kept], weights, groups, member, int(np.count_nonzero(weights))
        )


def read_sample(grid: ProcessGrid, problem: Problem) -> Sample:
    """Read a rank's share; ``problem`` is of all channels. Collective: all ranks of the grid."""
    n_freqs, problem = problem.observation.Nfreqs, problem.of_channels(grid.channels)
    with together(grid.world):
        times = np.union1d(problem.train.times, problem.test.times)
        bls = np.union1d(problem.train.bls, problem.test.bls)
        n_samples = len(bls) * len(times) * n_freqs
        thinned = bls[:: 1 + n_samples // MOST_SAMPLES]
        group = problem.redundant.group[thinned]
        mine = thinned[np.isin(group, np.array_split(np.unique(group), grid.group.size)[grid.group.rank])]
        stored = None
        if problem.job.noise.kind == "autocorrelations":
            stored = read_autos(problem.files, problem.observation, times)
        rows = read_rows(problem, Tile(times, mine), stored)
        beams = list(map(from_table, problem.beams))
        model = problem.forward_model(rows.groups).visibilities(beams, times)[:, :, rows.member]
        autos = _known_autos(problem, stored, np.array_split(np.arange(len(times)), grid.group.size)[grid.group.rank])
    return Sample(problem.channel_numbers, times, mine, rows.data, model, rows.inv_noise_var, autos)


def _known_autos(problem: Problem, stored: Block | None, some: IntArray) -> FloatArray:
    """Return the autocorrelations of some of the times where the noise is taken from them, (Nfreqs, Nsome, Nants)."""
    if stored is None:
        return np.full((problem.observation.Nfreqs, len(some), problem.observation.Nants), np.nan)
    known = stored.stored & ~stored.flags
    return np.where(known, stored.data.real, np.nan)[:, some].mean(axis=-1)


@dataclass(frozen=True)
class Kept:
    """What of the data still counts: nothing of these antennas (indices), times and baselines (indices)."""

    antennas: frozenset[int] = frozenset()
    times: frozenset[int] = frozenset()
    bls: frozenset[int] = frozenset()

    def weights(self, sample: Sample, ends: IntArray) -> FloatArray:
        """Return the weights of what counts; ``ends`` are the antennas of all baselines, (all, 2)."""
        gone = np.isin(ends[sample.bls], list(self.antennas)).any(axis=1) | np.isin(sample.bls, list(self.bls))
        late = np.isin(sample.times, list(self.times))
        return np.where(gone | late[:, np.newaxis], 0.0, sample.weights)


@dataclass
class Sums:
    """Sums over all ranks, each with one entry a channel and time or a channel and baseline.

    Attributes
    ----------
    time_products, bl_products : ndarray of complex, (3, Nfreqs, Ntimes or Nbls)
        sum w d m*, sum w |m|^2 and sum w |d|^2, with times as in the sample.
    time_counts, bl_counts : ndarray, (Nfreqs, Ntimes or Nbls)
        Number of visibilities that count.
    zeros : ndarray, (Nbls,)
        Number of those that are exactly zero.
    pairs, steps : ndarray, (Nbls,)
        Number of times at which that of the time before counts too, and of those with another visibility.
    """

    time_products: ComplexArray
    bl_products: ComplexArray
    time_counts: FloatArray
    bl_counts: FloatArray
    zeros: FloatArray
    pairs: FloatArray
    steps: FloatArray

    @classmethod
    def of(cls, grid: ProcessGrid, problem: Problem, sample: Sample, weights: FloatArray) -> Sums:
        """Add up what counts by ``weights``, (Nlocal, Ntimes, Nbls); ``problem`` is of all channels.

        Collective: all ranks of the grid.
        """
        n_freqs, n_bls, n_times = problem.observation.Nfreqs, problem.observation.Nbls, len(sample.times)
        made = cls(
            np.zeros((3, n_freqs, n_times), complex),
            np.zeros((3, n_freqs, n_bls), complex),
            np.zeros((n_freqs, n_times)),
            np.zeros((n_freqs, n_bls)),
            *np.zeros((3, n_bls)),
        )
        data, counts = sample.data, weights > 0
        products = [weights * data * sample.model.conj(), weights * np.abs(sample.model) ** 2]
        for k, product in enumerate([*products, weights * np.abs(data) ** 2]):
            made.time_products[k, sample.channels] = product.sum(axis=2)
            made.bl_products[k][np.ix_(sample.channels, sample.bls)] = product.sum(axis=1)
        made.time_counts[sample.channels] = counts.sum(axis=2)
        made.bl_counts[np.ix_(sample.channels, sample.bls)] = counts.sum(axis=1)
        made.zeros[sample.bls] = (counts & (data == 0)).sum(axis=(0, 1))
        both = counts[:, 1:] & counts[:, :-1]
        made.pairs[sample.bls] = both.sum(axis=(0, 1))
        made.steps[sample.bls] = (both & (data[:, 1:] != data[:, :-1])).sum(axis=(0, 1))
        for part in vars(made).values():
            allreduce_sum(grid.world, part)
        return made

    @property
    def scale(self) -> ComplexArray:
        """The complex scale of the data over the model beam's visibilities, best for half of the times, (Nfreqs,)."""
        return scale_of_half(self.time_products)

    def unexplained(self, scale: ComplexArray) -> FloatArray:
        """Return what the scaled model leaves beyond the noise over the scaled model's power, (Nfreqs,)."""
        overlap, model, data = self.time_products
        power = np.abs(scale[:, np.newaxis]) ** 2 * model.real
        left = data.real - 2 * (scale.conj()[:, np.newaxis] * overlap).real + power - self.time_counts
        known = power > 0
        ratio = np.where(known, left / np.where(known, power, 1.0), np.nan)
        return np.array([max(_median(one).real, 0.0) for one in ratio])


def scale_of_half(products: ComplexArray) -> ComplexArray:
    """Return the complex scale of data over model that is best for half of the times or baselines, (Nfreqs,).

    ``products``, (3, Nfreqs, N), are those of `Sums`.
    """
    overlap, model, _ = products
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.where(model.real > 0, overlap / np.where(model.real > 0, model.real, 1.0), np.nan)
    return np.array([_median(one) for one in ratio])


def _median(values: NDArray[np.complexfloating] | FloatArray) -> complex:
    """Return the medians of both parts of what is known; zero where nothing is."""
    known = values[~np.isnan(values)]
    return complex(np.median(known.real), np.median(known.imag)) if known.size else 0j


@dataclass
class Excess:
    """Logs of |residual|^2 over its expectation, summed over ranks: a mean of logs feels few wild samples little.

    The residual is the data minus the scaled model and minus the brightest source in what that leaves of a time; where
    times have neighbours, the second difference in time of data minus scaled model; or else the data minus the mean of
    their redundant partners.

    Attributes
    ----------
    says : str
        What is left of the data in these residuals, in words.
    differenced : bool
    times, bls, noise : ndarray, (2, Nlooks), (2, Nbls), (2, Nbls)
        Sums and numbers of logs. ``noise`` has only differences in which the sky moves little.
    middle : ndarray of int, (Nlooks,)
        The sample's time that each residual is of, or the middle one of its three.
    """

    says: str
    differenced: bool
    times: FloatArray
    bls: FloatArray
    noise: FloatArray
    middle: IntArray = field(default_factory=lambda: np.zeros(0, dtype=int))

    @classmethod
    def of(cls, grid: ProcessGrid, problem: Problem, sample: Sample, weights: FloatArray, sums: Sums) -> Excess:
        """Add up by ``weights``, (Nlocal, Ntimes, Nbls); ``problem`` is of all channels.

        Collective: all ranks of the grid.
        """
        observation = problem.observation
        scale, left = sums.scale[sample.channels], sums.unexplained(sums.scale)[sample.channels]
        middle = amid_neighbours(observation.times[sample.times] * PER_DAY, observation.integration_time[sample.times])
        differenced = 2 * len(middle) >= len(sample.times)
        n_looks = len(middle) if differenced else len(sample.times)
        made = cls(
            "what the model leaves of it",
            differenced,
            np.zeros((2, n_looks)),
            np.zeros((2, observation.Nbls)),
            np.zeros((2, observation.Nbls)),
            middle if differenced else np.arange(n_looks),
        )
        model = scale[:, np.newaxis, np.newaxis] * sample.model
        residual = sample.data - model
        variance = np.divide(1.0, weights, out=np.full(weights.shape, np.inf), where=weights > 0)
        if differenced:
            residual, model = second_differences(residual, middle, SECOND), second_differences(model, middle, SECOND)
            variance = second_differences(variance, middle, SECOND**2)
        else:
            # A source that the model lacks is no bad integration.
            residual = residual - brightest_source(grid, problem, (sample.channels, sample.bls), weights, residual)
        moving = np.abs(model) ** 2
        expected = variance + left[:, np.newaxis, np.newaxis] * moving
        power = np.abs(residual) ** 2
        known = np.isfinite(variance) & (power > 0)
        logs = np.where(known, np.log(np.where(known, power / expected, 1.0)) - LOG_MEAN, 0.0)
        made.times += logs.sum(axis=(0, 2)), known.sum(axis=(0, 2))
        made.bls[:, sample.bls] = logs.sum(axis=(0, 1)), known.sum(axis=(0, 1))
        if differenced:
            still = known & (moving < STILL * variance)
            made.noise[:, sample.bls] = np.where(still, logs, 0.0).sum(axis=(0, 1)), still.sum(axis=(0, 1))
        for part in (made.times, made.bls, made.noise):
            allreduce_sum(grid.world, part)
        return made

    @classmethod
    def of_partners(cls, grid: ProcessGrid, problem: Problem, sample: Sample, weights: FloatArray) -> Excess:
        """Add up what data differ by from the mean of their redundant partners at the same time and channel.

        Needs neither a model nor neighbouring times. Samples of a group of n have n - 1 differences among them. Gains
        make partners differ in proportion to what they see, which varies from time to time: what a baseline differs by
        in half of its samples is expected of all. Without redundancy there is nothing to look at.

        Collective: all ranks of the grid; ``problem`` is of all channels.
        """
        n_times = len(sample.times)
        made = cls(
            "what redundant baselines in it differ by",
            False,
            np.zeros((2, n_times)),
            np.zeros((2, problem.observation.Nbls)),
            np.zeros((2, problem.observation.Nbls)),
            np.arange(n_times),
        )
        for one in partner_means(problem.redundant.group[sample.bls], sample.data, weights, 1):
            variance, power = one.variance + one.variance_of_mean, np.abs(one.data - one.mean) ** 2
            known = power > 0
            seen = np.maximum(np.abs(one.mean) ** 2, variance)
            share = np.where(known, (power - variance) / seen, np.nan)
            share[:, ~known.any(axis=0)] = 0.0
            expected = variance + np.maximum(np.nanmedian(share, axis=0), 0.0) * seen
            logs = np.log(np.where(known, power / expected, 1.0)) - LOG_MEAN
            worth = np.where(known, one.n / (one.n + 1), 0.0)
            made.times += (worth * logs).sum(axis=1), worth.sum(axis=1)
        allreduce_sum(grid.world, made.times)
        return made


def second_differences(values: NDArray[Any], middle: IntArray, kernel: FloatArray) -> NDArray[Any]:
    """Apply a kernel of three to neighbouring times, (Nfreqs, Nmiddle, Nbls)."""
    first, second, third = (factor * values[:, middle + step] for factor, step in zip(kernel, (-1, 0, 1), strict=True))
    return np.asarray(first + second + third)
