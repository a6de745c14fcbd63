"""Antennas that are wrong as a whole: exchanged with another one, or with most of their baselines bad."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.inference.robust import known_median
from hydrabeam_mpi.loop.checks.alternatives import Alternative
from hydrabeam_mpi.loop.checks.bad_antennas import NOISE_SIGMAS
from hydrabeam_mpi.loop.checks.conventions import LEFT, Score, score_alternatives, score_model
from hydrabeam_mpi.loop.checks.health_sums import Sample, Sums, scale_of_half
from hydrabeam_mpi.mpi import ProcessGrid
from hydrabeam_mpi.setup.findings import Finding, antenna_words
from hydrabeam_mpi.setup.problem import Problem

MOST_ASKED = 4
"""Antennas among which exchanged ones are looked for at a time: two pairs, or one beside two others that are bad."""


def exchanged_antennas(grid: ProcessGrid, problem: Problem, sample: Sample, sums: Sums) -> list[Finding]:
    """Find pairs of antennas that have been exchanged, by their labels or by their cables.

    Of both the model beam explains less than of the others, and most of it once their places are exchanged. That is
    asked of those of which it explains least. Where it leaves no more of them than exchanged ones may leave, they are
    where they should be, and no other place is tried.
    Collective: all ranks of the grid.

    Parameters
    ----------
    grid : ProcessGrid
    problem : Problem
        Of all channels.
    sample : Sample
    sums : Sums
        Of what counts of it.
    """
    left = _unexplained(problem, sums)
    worst = [ant for ant in np.argsort(-left, kind="stable")[:MOST_ASKED].tolist() if left[ant] > np.log(LEFT)]
    found: list[Finding] = []
    free = set(problem.observation.antenna_numbers[worst].tolist())
    for pair in combinations(sorted(free), 2):
        if free.issuperset(pair):
            # Baselines with what is wrong in itself tell nothing of where these two are.
            stated, other = _exchanged(grid, problem, sample, pair, sorted(free.difference(pair)))
            if other.leaves_less(stated, LEFT):
                found.append(_of_pair(pair, stated, other))
                free -= set(pair)
    return found


def _unexplained(problem: Problem, sums: Sums) -> FloatArray:
    """Return ln of the share of the power beyond the noise that the scaled model leaves, (Nants,).

    The scale is that of half of the baselines, and so is what is left of an antenna: a few exchanged ones move neither.
    """
    overlap, model, data = sums.bl_products
    scale = scale_of_half(sums.bl_products)[:, np.newaxis]
    left = data.real - 2 * (scale.conj() * overlap).real + np.abs(scale) ** 2 * model.real
    beyond = data.real - sums.bl_counts
    hidden = NOISE_SIGMAS * np.sqrt(sums.bl_counts)
    shares = np.maximum(left - sums.bl_counts, hidden) / np.where(beyond > hidden, beyond, np.nan)
    logs = np.log(shares)
    index = problem.observation.antenna_index
    by_antenna = [logs[:, (index == ant).any(axis=1)] for ant in range(problem.observation.Nants)]
    return np.array([known_median(one.ravel()) for one in by_antenna])


def by_antenna(problem: Problem, found: Sequence[Finding]) -> list[Finding]:
    """Tell of antennas instead of their baselines where most of these are bad.

    Parameters
    ----------
    problem : Problem
        Of all channels.
    found : sequence of Finding
        About baselines, one each, and anything else.
    """
    bad = _bad_ends(problem, found)
    rest = [one for one in found if not {ant for pair in one.baselines for ant in pair} & set(bad)]
    return [*rest, *(_of_antenna(ant, *bad[ant]) for ant in sorted(bad))]


def _bad_ends(problem: Problem, found: Sequence[Finding]) -> dict[int, tuple[int, int]]:
    """Return antennas most of whose baselines are bad, with the numbers of bad ones and of all that are not left out.

    The worst antenna first: its baselines do not count against the others.
    """
    gone = {ant for one in found for ant in one.antennas}
    pairs = [frozenset(pair) for pair in problem.observation.antpairs.tolist() if not gone & set(pair)]
    bad = {frozenset(pair) for one in found for pair in one.baselines}
    ends: dict[int, tuple[int, int]] = {}
    while True:
        counts = {
            ant: (sum(ant in pair for pair in bad), sum(ant in pair for pair in pairs))
            for ant in sorted({ant for pair in bad for ant in pair})
        }
        worst = max(counts, key=lambda ant: counts[ant][0] / counts[ant][1], default=None)
        if worst is None or not 2 * counts[worst][0] > counts[worst][1] > 1:
            return ends
        ends[worst] = counts[worst]
        pairs = [pair for pair in pairs if worst not in pair]
        bad = {pair for pair in bad if worst not in pair}


def _exchanged(
    grid: ProcessGrid, problem: Problem, sample: Sample, pair: tuple[int, int], without: Sequence[int]
) -> tuple[Score, Score]:
    """Compare the baselines of two antennas with the model beam, as stated and with the antennas' places exchanged.

    Those with some other antennas are left ``without``. Collective: all ranks of the grid.
    """
    observation = problem.observation
    one, two = (int(np.flatnonzero(observation.antenna_numbers == ant)[0]) for ant in pair)
    antpos = observation.antpos.copy()
    antpos[[one, two]] = antpos[[two, one]]
    antpairs = observation.antpairs[sample.bls]
    theirs = np.asarray(np.isin(antpairs, pair).any(axis=1) & ~np.isin(antpairs, without).any(axis=1))
    rows = sample.rows(problem, theirs)
    stated = score_model(grid, problem, rows, sample.model[..., theirs])
    exchanged = [Alternative("exchanged", antpos=antpos)]
    (other,) = score_alternatives(grid, problem.of_channels(grid.channels), rows, exchanged)
    return stated, other


def _of_pair(pair: tuple[int, int], stated: Score, other: Score) -> Finding:
    one, two = pair
    why = (
        f"with their places exchanged the model beam explains {other.explained:.1%} of their visibilities, and "
        f"{max(stated.explained, 0):.1%} as stated"
    )
    remedy = f"exchange their positions in the files, or exclude_antennas = [{one}, {two}] in [data]"
    return Finding("two antennas exchanged", f"antennas {one} and {two}", why, remedy, antennas=pair)


def _of_antenna(number: int, n_bad: int, n_all: int) -> Finding:
    name, remedy = antenna_words(number)
    return Finding("a bad antenna", name, f"{n_bad} of its {n_all} baselines are bad", remedy, antennas=(number,))
