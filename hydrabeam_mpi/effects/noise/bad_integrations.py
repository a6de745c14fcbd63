"""A few integrations with something else on all baselines, such as interference: each has a noise scale of its own.

What redundant baselines have in common is in the sky, or comes from afar. With Q_g the power of what the n_g rows of
group g have in common, z_g = sum z / sqrt(n_g), and Q that of all rows, noise of its own size in each row gains

    ln L = -N ln(Q / N) - N        (N rows)

and a signal of the sky beside what all other integrations have, of variance u,

    ln L = -G ln(sum Q_g / G) - G - (N - G) ln u - (Q - sum Q_g) / u        (G groups).

Where the latter is more, the integration has such a signal, of which nobody knows what it is: see
`unknown_integrations`. All others are bad.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import numpy as np
from scipy.sparse import csr_array

from hydrabeam_mpi.data.observation import BoolArray, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.noise.standing_out import Choice, StandingOut, Sums, choose, means_of
from hydrabeam_mpi.inference.robust import known_median


class Redundant(NamedTuple):
    """Of redundant groups of which an integration has several rows: how many, of how many rows, and their power.

    ``common`` is the power of what all rows of a group have in common, G for noise, and ``power`` that of all, N. All
    are (Nfreqs, 2, Ntimes), of fitted and of held-out rows.
    """

    groups: FloatArray
    rows: FloatArray
    common: FloatArray
    power: FloatArray


class BadIntegrations(StandingOut):
    """Integrations to leave out, as they stand out from all others of the data.

    The parameters of a channel are the noise scales of all integrations: one for those that are as they should be.
    """

    kind = "bad_integrations"
    title = "bad integrations"
    parts = "integrations"
    n_further = len(Redundant._fields)
    have_signal: ClassVar[bool] = False
    """Whether they are those that have a signal of the sky, and not those that have noise of their own size."""

    def neutral(self, setup: ObservingSetup) -> dict[str, float]:
        """Return ones."""
        return dict.fromkeys((f"JD {jd:.6f} noise scale" for jd in setup.observation.times[setup.times]), 1.0)

    def looked_at(self, setup: ObservingSetup) -> IntArray:
        """Return the times that are looked at."""
        return setup.times

    def by_part(self, setup: ObservingSetup, times: IntArray, bls: IntArray, rows: FloatArray) -> FloatArray:
        """Add up something of rows by time."""
        found = np.zeros(setup.observation.Ntimes)
        found[times] = rows.sum(axis=1)
        return found

    def scales(self, setup: ObservingSetup, times: IntArray, bls: IntArray, x: FloatArray) -> FloatArray:
        """Return the noise scales of times, (Ntimes, 1)."""
        return x[np.searchsorted(setup.times, times)][:, np.newaxis]

    def further(self, setup: ObservingSetup, times: IntArray, bls: IntArray, z: ComplexArray) -> list[FloatArray]:
        """Return what redundant groups of several rows have, by time: see `Redundant`."""
        names, member = np.unique(setup.redundant.group[bls], return_inverse=True)
        of_group = csr_array((np.ones(len(bls)), (np.arange(len(bls)), member)), shape=(len(bls), len(names)))
        n, power = (z != 0).astype(float) @ of_group, np.abs(z) ** 2 @ of_group
        common, several = np.abs(z @ of_group) ** 2 / np.maximum(n, 1), n > 1
        each = Redundant(several.astype(float), n * several, common * several, power * several)
        return [self.by_part(setup, times, bls, one) for one in each]

    def choices(self, setup: ObservingSetup, sums: Sums, further: FloatArray) -> Sequence[Choice]:
        """Return those that stand out and have a signal of the sky, or have none."""
        choice = choose(sums)
        have_signal = _have_signal(choice, sums, Redundant(*further))
        return [choice._replace(bad=choice.bad & (have_signal == self.have_signal))]


def _have_signal(choice: Choice, sums: Sums, redundant: Redundant) -> BoolArray:
    """Return which integrations have rather a signal of the sky than noise of their own size, (Ntimes,)."""
    groups, rows, common, power = redundant
    ratios = means_of(sums.powers, sums.numbers)
    usual = np.nan_to_num([[[known_median(role)] for role in channel] for channel in ratios], nan=1.0)
    of_noise = -_n_ln_mean(rows, power) - rows
    of_sky = -_n_ln_mean(groups, common) - groups - (rows - groups) * np.log(usual) - (power - common) / usual
    return np.asarray(np.where(choice.bad[:, np.newaxis], of_sky - of_noise, 0.0).sum(axis=(0, 1)) > 0)


def _n_ln_mean(n: FloatArray, total: FloatArray) -> FloatArray:
    """Return n ln(total / n), zero where there are none."""
    return n * np.log(np.divide(total, n, out=np.ones_like(total), where=(n > 0) & (total > 0)))
