"""Integrations, antennas and baselines that are off against the others of their kind, after a fit.

Fitted and held-out rows are looked at alike, each among their own: a fit leaves less in the rows that it has seen. What
is off everywhere, as by an effect that nobody knows, makes the others' scatter large, and nothing stands out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray, IntArray, Observation
from hydrabeam_mpi.inference.robust import (
    LOG_MEAN,
    LOG_STD,
    MOST_EXCEPTIONS,
    beside_median,
    medians_of_antennas,
    outliers,
)
from hydrabeam_mpi.mpi import Comm, allreduce_sum
from hydrabeam_mpi.setup.findings import Finding, antenna_words, baseline_words, integration_words

ROLES = ("fitted", "held out")


@dataclass
class RowPower:
    """Logs of |z|^2 over its expectation for noise: a mean of logs feels few wild samples little.

    Attributes
    ----------
    times, bls : ndarray, (2, 2, Ntimes), (2, 2, Nbls)
        Of fitted and of held-out rows: sums, and how many there are.
    """

    times: FloatArray
    bls: FloatArray

    @classmethod
    def zeros(cls, observation: Observation) -> RowPower:
        """Return sums of nothing."""
        return cls(np.zeros((2, 2, observation.Ntimes)), np.zeros((2, 2, observation.Nbls)))

    def add(self, role: int, times: IntArray, bls: IntArray, z: ComplexArray) -> None:
        """Add whitened residuals of a channel, (Ntimes, Nbls), with E|z|^2 = 2 and zero where there are none."""
        known = z != 0
        logs = np.where(known, np.log(np.where(known, 0.5 * np.abs(z) ** 2, 1.0)) - LOG_MEAN, 0.0)
        for k, values in enumerate((logs, known)):
            self.times[role, k, times] += values.sum(axis=1)
            self.bls[role, k, bls] += values.sum(axis=0)

    def reduce(self, comm: Comm) -> RowPower:
        """Add up over ranks. Collective: all ranks of `comm`."""
        allreduce_sum(comm, self.times)
        allreduce_sum(comm, self.bls)
        return self


def odd_rows(power: RowPower, observation: Observation) -> tuple[Finding, ...]:
    """Return a line for each integration, antenna and baseline that stands out, with the key that leaves it out.

    Nothing is left out by itself: they may be bad, or carry an effect that is not known.

    Parameters
    ----------
    power : RowPower
        Of all ranks.
    observation : Observation
        Of all channels.
    """
    ends, found = observation.antenna_index, []
    for t, why in _stand_out(*_means(power.times)):
        place, remedy, span = integration_words(observation.times[[t]], observation.integration_time[[t]])
        found.append(Finding("an integration that stands out", place, why, f"if it is bad, {remedy}", times=(span,)))
    logs, n = _means(power.bls)
    antennas = dict(_stand_out(*medians_of_antennas(logs, n, ends)))
    for ant, why in antennas.items():
        place, remedy = antenna_words(int(observation.antenna_numbers[ant]))
        found.append(Finding("an antenna that stands out", place, why, f"if it is bad, {remedy}"))
    for b, why in _stand_out(logs, n):
        # Of an antenna that is named all baselines may.
        if not antennas.keys() & set(ends[b].tolist()):
            place, remedy = baseline_words(*observation.antpairs[b].tolist())
            found.append(Finding("a baseline that stands out", place, why, f"if it is bad, {remedy}"))
    return tuple(found)


def _means(sums: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mean logs, NaN where there are none, and their numbers, both (2, N); ``sums`` as those of `RowPower`."""
    total, n = sums.swapaxes(0, 1)
    return np.where(n > 0, total / np.maximum(n, 1), np.nan), n


def _stand_out(logs: FloatArray, n: FloatArray) -> list[tuple[int, str]]:
    """Return what is off among all, and by how much: mean logs and their numbers, (2, N)."""
    # Beside the median of their role, so that there is one scatter, known as well as can be.
    beside = beside_median(logs)
    error = LOG_STD / np.sqrt(np.maximum(n, 1))
    sigma = outliers(beside.ravel(), error.ravel(), spread=0.0).reshape(beside.shape)
    odd = np.flatnonzero((sigma > 0).any(axis=0)).tolist()
    if len(odd) > MOST_EXCEPTIONS * np.count_nonzero(n.any(axis=0)):
        return []
    return [(k, f"it has {_words(np.exp(beside[:, k]), sigma[:, k])}") for k in odd]


def _words(ratios: FloatArray, sigma: FloatArray) -> str:
    return " and ".join(
        f"{ratio:.2g} times what the fit leaves of the others, {role} ({one:.0f} sigma)"
        for role, ratio, one in zip(ROLES, ratios, sigma, strict=True)
        if one > 0
    )
