"""A sample of the held-out visibilities with what models say of them, small enough to be kept with a result."""

from __future__ import annotations

import numpy as np

from hydrabeam_mpi.data.observation import Array, ComplexArray, FloatArray, Observation
from hydrabeam_mpi.data.partition import Tile
from hydrabeam_mpi.fit.rows import Rows
from hydrabeam_mpi.mpi import ProcessGrid, allreduce_sum
from hydrabeam_mpi.setup.problem import Problem

MOST_TIMES, MOST_BASELINES = 480, 64
"""In the sample. With these a channel has 0.9 MB, a thirtieth of the covariance of 2048 modes; and more baselines can
hardly be told apart in a figure."""


def sampled_rows(observation: Observation, rows: Tile) -> Tile:
    """Choose times, evenly, and baselines, evenly among those sorted by length; the same on all ranks."""
    lengths = np.linalg.norm(observation.bl_vectors[rows.bls], axis=1)
    by_length = rows.bls[np.argsort(lengths.round(3), kind="stable")]
    return Tile(_evenly(rows.times, MOST_TIMES), _evenly(by_length, MOST_BASELINES))


def _evenly(values: Array, most: int) -> Array:
    """Return every n-th: what is evenly sampled stays so."""
    return values[:: max(1, -(-len(values) // most))]


def heldout_sample(
    grid: ProcessGrid,
    problem: Problem,
    read: Rows,
    before: ComplexArray,
    calibrated: Rows,
    after: ComplexArray,
    factor: ComplexArray | None = None,
) -> list[dict[str, Array]]:
    """Bring the sample together, and reduced chi^2 by baseline of all held-out rows.

    Collective: all ranks of the group.

    Parameters
    ----------
    grid : ProcessGrid
    problem : Problem
        Of the group's channels.
    read : Rows
        The rank's held-out rows as they were read.
    before : ndarray of complex, (Nlocal, Ntimes, Ngroups)
        What the model beam predicts of these.
    calibrated : Rows
        The same with effects taken out.
    after : ndarray of complex, (Nlocal, Ntimes, Ngroups)
        What the inferred beam predicts of these.
    factor : ndarray of complex, (Nlocal, Ntimes, Nbls), optional
        What effects multiply visibilities by.

    Returns
    -------
    list of dict
        The arrays of each channel by their names in ``posterior.h5``; none where nothing was held out.
    """
    observation, flipped = problem.observation, problem.redundant.flipped
    chosen = sampled_rows(observation, problem.test)
    if not chosen.size:
        return [{} for _ in before]
    found = []
    for f in range(len(before)):
        gain = np.ones(read.data.shape[1:]) if factor is None else factor[f]
        power = np.abs(gain) ** 2
        weights = np.divide(calibrated.inv_noise_var[f], power, out=np.zeros_like(power), where=power > 0)
        # What is flagged may be anything.
        data, left, left_before = (
            np.where(weights > 0, values, 0.0)
            for values in (
                read.data[f],
                gain * (calibrated.data[f] - after[f][:, read.member]),
                read.data[f] - before[f][:, read.member],
            )
        )
        sample = _gathered(grid, read.tile, chosen, [data, data - left_before, data - left, weights])
        visibilities = np.where(flipped[chosen.bls], sample[:3].conj(), sample[:3]).astype(np.complex64)
        found.append(
            dict(zip(("heldout_data", "heldout_before", "heldout_after"), visibilities, strict=True))
            | {"heldout_weights": sample[3].real.astype(np.float32)}
            | _by_baseline(grid, observation, read.tile, weights, [left_before, left])
        )
    return found


def _gathered(grid: ProcessGrid, mine: Tile, chosen: Tile, parts: list[Array]) -> ComplexArray:
    """Return the chosen rows of all ranks' arrays, (len(parts), Ntimes, Nbls)."""
    times, bls = np.isin(mine.times, chosen.times), np.isin(mine.bls, chosen.bls)
    place = np.ix_(_places(chosen.times, mine.times[times]), _places(chosen.bls, mine.bls[bls]))
    sample = np.zeros((len(parts), len(chosen.times), len(chosen.bls)), dtype=complex)
    for one, values in zip(sample, parts, strict=True):
        one[place] = values[np.ix_(times, bls)]
    allreduce_sum(grid.group, sample)  # each row is on one rank
    return sample


def _places(values: Array, some: Array) -> Array:
    """Return where some are among values, which need not ascend."""
    order = np.argsort(values)
    return order[np.searchsorted(values, some, sorter=order)]


def _by_baseline(
    grid: ProcessGrid, observation: Observation, mine: Tile, weights: FloatArray, residuals: list[ComplexArray]
) -> dict[str, Array]:
    """Return how many data each baseline has, (Nbls,), and their reduced chi^2, (len(residuals), Nbls)."""
    terms = [weights > 0, *(weights * np.abs(left) ** 2 for left in residuals)]
    sums = np.zeros((len(terms), observation.Nbls))
    sums[:, mine.bls] = [of_rows.sum(axis=0) for of_rows in terms]
    allreduce_sum(grid.group, sums)
    chi2 = sums[1:] / np.maximum(sums[0], 1)
    return {"baseline_n": sums[0].astype(np.int32), "baseline_chi2": chi2.astype(np.float32)}
