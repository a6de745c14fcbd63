"""Antennas most of whose baselines are bad."""

from __future__ import annotations

from collections.abc import Sequence

from hydrabeam_mpi.setup.findings import Finding, antenna_words
from hydrabeam_mpi.setup.problem import Problem


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


def _of_antenna(number: int, n_bad: int, n_all: int) -> Finding:
    name, remedy = antenna_words(number)
    return Finding("a bad antenna", name, f"{n_bad} of its {n_all} baselines are bad", remedy, antennas=(number,))
