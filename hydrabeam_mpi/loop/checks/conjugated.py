"""Single baselines whose visibilities are conjugated, as where two antennas were written in the wrong order."""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.inference.robust import known_median
from hydrabeam_mpi.loop.checks.conventions import AMPLITUDE_TOLERANCE, LEFT, MIN_FALL
from hydrabeam_mpi.loop.checks.health_sums import Sample, Sums
from hydrabeam_mpi.mpi import ProcessGrid, allreduce_sum
from hydrabeam_mpi.setup.findings import Finding, baseline_words
from hydrabeam_mpi.setup.problem import Problem


def conjugated_baselines(
    grid: ProcessGrid, problem: Problem, sample: Sample, weights: FloatArray, sums: Sums
) -> list[Finding]:
    """Find baselines of which the model beam explains most once they are conjugated, and little as they are.

    Either way it has a complex factor of its own in each channel, as any gains would give it, so that what tells is how
    phases go on in time. The other way round that is as large as those of most baselines: what else is on one, such as
    a transmitter, may have phases that go on in any way, but no such size. Where most baselines are so that is a
    convention of the data, and none of them is wrong by itself.
    Collective: all ranks of the grid.

    Parameters
    ----------
    grid : ProcessGrid
    problem : Problem
        Of all channels.
    sample : Sample
    weights : ndarray, (Nlocal, Ntimes, Nbls)
        Of what counts of it.
    sums : Sums
        Of what counts.
    """
    mirrored = np.zeros((problem.observation.Nfreqs, problem.observation.Nbls), dtype=complex)
    products = np.sum(weights * sample.data * sample.model, axis=1)
    mirrored[np.ix_(sample.channels, sample.bls)] = products
    allreduce_sum(grid.world, mirrored)
    overlap, model, data = sums.bl_products
    power, n = data.real.sum(axis=0), sums.bl_counts.sum(axis=0)
    explained = np.array([_ratio(np.abs(one) ** 2, model.real).sum(axis=0) for one in (overlap, mirrored)])
    as_stated, conjugated = np.maximum(power - n - explained, 0.0)
    each, other = (_ratio(np.abs(one).sum(axis=0), model.real.sum(axis=0)) for one in (overlap, mirrored))
    amplitude = other / known_median(np.where(n > 0, each, np.nan))
    found = (conjugated < LEFT * as_stated) & (explained[1] - explained[0] > MIN_FALL)
    found &= np.abs(amplitude - 1) < AMPLITUDE_TOLERANCE
    if 2 * np.count_nonzero(found) > np.count_nonzero(n):
        return []
    left = _ratio(np.array([as_stated, conjugated]), power - n)
    return [_of_baseline(problem, b, *left[:, b].tolist()) for b in np.flatnonzero(found).tolist()]


def _ratio(one: FloatArray, two: FloatArray) -> FloatArray:
    """Return one over the other, zero where that is not positive."""
    two = np.broadcast_to(two, one.shape)
    return np.divide(one, two, out=np.zeros_like(one), where=two > 0)


def _of_baseline(problem: Problem, number: int, as_stated: float, conjugated: float) -> Finding:
    """Say it of a baseline, of whose power beyond the noise the model beam leaves these parts."""
    one, two = (int(ant) for ant in problem.observation.antpairs[number])
    name, remedy = baseline_words(one, two)
    why = (
        f"the model beam explains {max(1 - as_stated, 0):.1%} of its visibilities, and conjugated {1 - conjugated:.1%}"
    )
    mending = f"conjugate its data, or write them with its antennas exchanged, or {remedy}"
    return Finding("a conjugated baseline", name, why, mending, baselines=((one, two),))
