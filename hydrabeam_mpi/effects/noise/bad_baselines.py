"""A few baselines, or all of an antenna, with something else in them that no effect describes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray, IntArray
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.noise.standing_out import Choice, StandingOut, Sums, choose, means_of
from hydrabeam_mpi.inference.robust import medians_of_antennas


class BadBaselines(StandingOut):
    """Baselines to leave out, as they stand out from all others of the data, by themselves or as those of an antenna.

    The parameters of a channel are the noise scales of all baselines: one for those that are as they should be.
    """

    kind = "bad_baselines"
    title = "bad baselines"
    parts = "baselines"
    is_of_unknown = True

    def neutral(self, setup: ObservingSetup) -> dict[str, float]:
        """Return ones."""
        return dict.fromkeys((f"baseline {a}-{b} noise scale" for a, b in setup.observation.antpairs.tolist()), 1.0)

    def looked_at(self, setup: ObservingSetup) -> IntArray:
        """Return all baselines."""
        return np.arange(setup.observation.Nbls)

    def by_part(self, setup: ObservingSetup, times: IntArray, bls: IntArray, rows: FloatArray) -> FloatArray:
        """Add up something of rows by baseline."""
        found = np.zeros(setup.observation.Nbls)
        found[bls] = rows.sum(axis=0)
        return found

    def scales(self, setup: ObservingSetup, times: IntArray, bls: IntArray, x: FloatArray) -> FloatArray:
        """Return the noise scales of baselines, (1, Nbls)."""
        return x[np.newaxis, bls]

    def choices(self, setup: ObservingSetup, sums: Sums, further: FloatArray) -> Sequence[Choice]:
        """Return those that stand out among all, and all those of antennas that stand out with others that do beside.

        Of seven antennas one has more than a quarter of all baselines, and is one of a few antennas nevertheless.
        """
        antennas, found = choose(_by_antenna(setup, sums)), [_choose(setup, sums)]
        if antennas.bad.any():
            mine = antennas.bad[:, setup.observation.antenna_index].sum(axis=2) > 0
            others = _choose(setup, sums.without(mine))
            log_choices = antennas.log_choices + others.log_choices
            found.append(Choice(mine | others.bad, log_choices, antennas.many or others.many))
        return found


def _choose(setup: ObservingSetup, sums: Sums) -> Choice:
    """Return the baselines that stand out, without those of which most redundant partners do, too.

    What redundant baselines have in common is in the sky, or in the beam.
    """
    choice, group = choose(sums), setup.redundant.group
    known = sums.numbers.sum(axis=1) > 0
    n, n_bad = (np.array([np.bincount(group, one)[group] for one in each]) for each in (known, choice.bad))
    return choice._replace(bad=choice.bad & ((n < 2) | (n_bad <= 0.5 * n)))


def _by_antenna(setup: ObservingSetup, sums: Sums) -> Sums:
    """Return medians over each antenna's baselines as sums, (Nfreqs, 2, Nants), of as many rows as they are worth.

    Fitted and held-out rows count as of one sort, the first.
    """
    numbers, *totals = (one.sum(axis=1) for one in sums)
    ends = setup.observation.antenna_index
    (logs, worth), (powers, _) = (medians_of_antennas(means_of(one, numbers), numbers, ends) for one in totals)
    each = (worth, *(np.where(worth > 0, worth * medians, 0.0) for medians in (logs, powers)))
    return Sums(*(np.stack([one, np.zeros_like(one)], axis=1) for one in each))
