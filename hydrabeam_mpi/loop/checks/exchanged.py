"""Antennas that have been exchanged, by their labels or by their cables, throughout or for a while."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Self

import numpy as np

from hydrabeam_mpi.data.observation import BoolArray, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.fit.rows import Rows
from hydrabeam_mpi.inference.robust import known_median
from hydrabeam_mpi.loop.checks.alternatives import Alternative, predictions
from hydrabeam_mpi.loop.checks.bad_antennas import NOISE_SIGMAS
from hydrabeam_mpi.loop.checks.conventions import LEFT, Score, sample_times
from hydrabeam_mpi.loop.checks.health_sums import Sample
from hydrabeam_mpi.mpi import ProcessGrid, allreduce_sum, together
from hydrabeam_mpi.setup.findings import Finding
from hydrabeam_mpi.setup.problem import Problem

MOST_ASKED = 4
"""Antennas among which exchanged ones are looked for at a time: two pairs, or one beside two others that are bad."""
QUARTER = 0.25
"""Of the baselines, which are right at least: of seven antennas of which three are wrong, six of 21."""
SCALES = 64
"""Baselines whose own scale of the data over the model is tried for all."""
FEW_TIMES = 16
"""At which a pair is asked first: two in each of `PARTS`."""
PARTS = 8
"""Of the times: antennas are asked that are worse than others in all of them, or else in an eighth of them."""


def exchanged_antennas(
    grid: ProcessGrid, problem: Problem, sample: Sample, weights: FloatArray, products: ComplexArray
) -> list[Finding]:
    """Find pairs of antennas that have been exchanged, by their labels or by their cables, throughout or for a while.

    Of both the model beam explains less than of the others then, and most of it once their places are exchanged. That
    is asked of those of which it explains least. Where it leaves no more of them than exchanged ones may leave, they
    are where they should be, and no other place is tried.
    Collective: all ranks of the grid.

    Parameters
    ----------
    grid : ProcessGrid
    problem : Problem
        Of all channels.
    sample : Sample
    weights : ndarray, (Nlocal, Ntimes, Nbls)
        Of what counts of it.
    products : ndarray of complex, (3, Nfreqs, Nbls)
        Of data and model; see `Sums`.
    """
    scale, power = _scale_of_quarter(products), products[2].real.sum(axis=0)
    by_part = _power_by_part(grid, problem, sample, weights, scale)
    known: list[set[int]] = []
    for sums in (by_part.sum(axis=1, keepdims=True), by_part):
        left = _unexplained(problem, sums)
        worst = [ant for ant in np.argsort(-left, kind="stable")[:MOST_ASKED].tolist() if left[ant] > np.log(LEFT)]
        free = set(problem.observation.antenna_numbers[worst].tolist())
        found = [] if free in known else _exchanged_among(grid, problem, sample, free, scale, power)
        if found:
            return found
        known.append(free)
    return []


def _scale_of_quarter(products: ComplexArray) -> ComplexArray:
    """Return the complex scale of data over model that leaves least of a quarter of the baselines, (Nfreqs,).

    Of a small array two exchanged antennas, and one with a wrong phase, have more than half of the baselines.
    """
    found = np.zeros(products.shape[1], dtype=complex)
    for channel, (overlap, model, data) in enumerate(products.swapaxes(0, 1)):
        known = (model.real > 0) & (data.real > 0)
        overlap, model, data = overlap[known], model.real[known], data.real[known]
        if not len(model):
            continue
        own = overlap / model
        asked = own[:: -(-len(own) // SCALES)]
        shares = [(data - 2 * (one.conjugate() * overlap).real + abs(one) ** 2 * model) / data for one in asked]
        found[channel] = asked[np.argmin(np.quantile(shares, QUARTER, axis=1))]
    return found


def _exchanged_among(
    grid: ProcessGrid, problem: Problem, sample: Sample, free: set[int], scale: ComplexArray, power: FloatArray
) -> list[Finding]:
    """Find pairs among some antennas, whose numbers are ``free``; ``power`` is of all data, (Nbls,).

    Collective: all ranks of the grid.
    """
    found: list[Finding] = []
    for pair in combinations(sorted(free), 2):
        if free.issuperset(pair):
            # Baselines with what is wrong in itself tell nothing of where these two are.
            asked = _Pair.of(problem, sample, pair, sorted(free.difference(pair)), power)
            one = asked.exchanged_when(grid, problem, scale)
            if one is not None:
                found.append(one)
                free = free - set(pair)
    return found


def _power_by_part(
    grid: ProcessGrid, problem: Problem, sample: Sample, weights: FloatArray, scale: ComplexArray
) -> FloatArray:
    """Return sum w |d - scale m|^2, sum w |d|^2 and the number of visibilities, (3, `PARTS`, Nbls). Collective."""
    left, data, n = sums = np.zeros((3, PARTS, problem.observation.Nbls))
    for t in range(len(sample.times)):
        part, some = t * PARTS // len(sample.times), weights[:, t]
        residual = sample.data[:, t] - scale[sample.channels, np.newaxis] * sample.model[:, t]
        left[part, sample.bls] += np.sum(some * np.abs(residual) ** 2, axis=0)
        data[part, sample.bls] += np.sum(some * np.abs(sample.data[:, t]) ** 2, axis=0)
        n[part, sample.bls] += np.count_nonzero(some, axis=0)
    allreduce_sum(grid.world, sums)
    return sums


def _unexplained(problem: Problem, sums: FloatArray) -> FloatArray:
    """Return ln of the share of the power beyond the noise that the scaled model leaves where that is most, (Nants,).

    That is in one of the parts of `_power_by_part`. Baselines count where noise alone leaves less than exchanged
    antennas may, and parts in which the model leaves less than that of a quarter of the baselines: else it is the
    model's fault.
    """
    observation, (left, data, n) = problem.observation, sums
    hidden = NOISE_SIGMAS * np.sqrt(n)
    known = data - n > hidden / LEFT
    shares = np.where(known, np.maximum(left - n, hidden) / np.where(known, data - n, 1.0), np.nan)
    index, most = observation.antenna_index, np.full(observation.Nants, np.nan)
    for of_part in shares:
        told = of_part[~np.isnan(of_part)]
        if len(told) and np.quantile(told, QUARTER) < LEFT:
            medians = [known_median(of_part[(index == ant).any(axis=1)]) for ant in range(observation.Nants)]
            most = np.fmax(most, medians)
    return np.log(most)


@dataclass(frozen=True)
class _Pair:
    """The baselines of two antennas, and the array with the places of these exchanged.

    Attributes
    ----------
    pair : tuple of int
        Their numbers.
    rows : Rows
        Of a rank.
    model : ndarray of complex, (Nlocal, Ntimes, Nbls)
        The model beam's visibilities as stated, Jy.
    exchanged : Alternative
    share : ndarray, (Nbls,)
        Of each baseline's weights, that counts: no baseline has more power than half of them do. The shortest may have
        most of all power, from diffuse emission that the model lacks.
    """

    pair: tuple[int, int]
    rows: Rows
    model: ComplexArray
    exchanged: Alternative
    share: FloatArray

    @classmethod
    def of(
        cls, problem: Problem, sample: Sample, pair: tuple[int, int], without: Sequence[int], power: FloatArray
    ) -> Self:
        """Choose the baselines of two antennas; those with some other antennas are left ``without``.

        ``power``, (Nbls,), is that of the data on all baselines of the array.
        """
        observation = problem.observation
        one, two = (int(np.flatnonzero(observation.antenna_numbers == ant)[0]) for ant in pair)
        antpos = observation.antpos.copy()
        antpos[[one, two]] = antpos[[two, one]]
        of_pair, of_bad = (np.isin(observation.antpairs, some).any(axis=1) for some in (pair, without))
        all_theirs = np.asarray(of_pair & ~of_bad)
        middle = known_median(np.where(all_theirs & (power > 0), power, np.nan))
        share = np.divide(middle, power, out=np.ones_like(power), where=power > middle)
        theirs = all_theirs[sample.bls]
        alternative = Alternative("exchanged", antpos=antpos)
        rows = sample.rows(problem, theirs)
        return cls(pair, rows, sample.model[..., theirs], alternative, share[sample.bls[theirs]])

    def exchanged_when(self, grid: ProcessGrid, problem: Problem, scale: ComplexArray) -> Finding | None:
        """Tell whether they were exchanged, and for how long: at a few times, then at all of them if they were.

        ``scale``, (Nfreqs,), is that of all data over the model. Collective: all ranks of the grid.
        """
        every = np.arange(len(self.rows.tile.times))
        found = self._exchanged_at(grid, problem, scale, sample_times(every, FEW_TIMES))
        return found and (self._exchanged_at(grid, problem, scale, every) or found)

    def _exchanged_at(
        self, grid: ProcessGrid, problem: Problem, scale: ComplexArray, chosen: IntArray
    ) -> Finding | None:
        """Look at some of the rows' times, (Nchosen,).

        They were exchanged in that run of times of which the exchanged model leaves less than the stated one by most.
        At all others they are where they should be, or nothing tells that they are.
        """
        stated, other = self._by_time(grid, problem, chosen)
        amplitude = float(np.median(scale.real))
        first, last = _run_of_most(amplitude * (2 * (other - stated)[2] - amplitude * (other - stated)[3]))
        within = np.zeros(len(chosen), dtype=bool)
        within[first:last] = True
        then, rest = ([_score(one, some) for one in (stated, other)] for some in (within, ~within))
        if not then[1].leaves_less(then[0], LEFT):
            return None
        times = problem.observation.times[self.rows.tile.times[chosen]]
        if rest[0].leaves_less(rest[1], LEFT):
            return _of_pair(self.pair, then[0], then[1], during=(float(times[first]), float(times[last - 1])))
        of_all = [_score(one, np.ones_like(within)) for one in (stated, other)]
        return _of_pair(self.pair, of_all[0], of_all[1]) if of_all[1].leaves_less(of_all[0], LEFT) else None

    def _by_time(self, grid: ProcessGrid, problem: Problem, chosen: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return what a `Score` has, of each of some times, as stated and exchanged, (4, Nchosen) each. Collective."""
        weights = self.rows.inv_noise_var[:, chosen] * self.share
        data, stated = self.rows.data[:, chosen], self.model[:, chosen]
        sums = np.zeros((2, 4, len(chosen)))
        with together(grid.world):
            exchanged = np.zeros_like(stated)
            if len(self.rows.tile.bls):
                place = {t: number for number, t in enumerate(chosen.tolist())}
                of_group = problem.of_channels(grid.channels)
                for _, t, vis in predictions(of_group, self.rows, [self.exchanged], chosen):
                    exchanged[:, place[t]] = vis
            for one, model in zip(sums, (stated, exchanged), strict=True):
                products = (data.conj() * model).real, np.abs(model) ** 2
                one[0] = np.sum((weights > 0) * self.share, axis=(0, 2))
                one[1:] = [np.sum(weights * part, axis=(0, 2)) for part in (np.abs(data) ** 2, *products)]
        allreduce_sum(grid.world, sums)
        return sums[0], sums[1]


def _score(by_time: FloatArray, some: BoolArray) -> Score:
    """Add up what `_Pair._by_time` returns of some times, (Ntimes,)."""
    return Score(*by_time[:, some].sum(axis=1).tolist())


def _run_of_most(gain: FloatArray) -> tuple[int, int]:
    """Return where the run of entries with the largest sum begins, and where it has ended; at least one entry."""
    sums = np.concatenate([[0.0], np.cumsum(gain)])
    lowest = np.minimum.accumulate(sums[:-1])
    end = int(np.argmax(sums[1:] - lowest)) + 1
    return int(np.argmin(sums[:end])), end


def _of_pair(pair: tuple[int, int], stated: Score, other: Score, during: tuple[float, float] | None = None) -> Finding:
    one, two = pair
    why = (
        f"with their places exchanged the model beam explains {other.explained:.1%} of their visibilities"
        f"{' then' if during else ''}, and {max(stated.explained, 0):.1%} as stated"
    )
    where = f"antennas {one} and {two}"
    mending = "exchange their positions in the files"
    if during is not None:
        where += f", JD {during[0]:.6f} to {during[1]:.6f}"
        mending = "exchange their numbers in the files of these times"
    remedy = f"{mending}, or exclude_antennas = [{one}, {two}] in [data]"
    return Finding("two antennas exchanged", where, why, remedy, antennas=pair)
