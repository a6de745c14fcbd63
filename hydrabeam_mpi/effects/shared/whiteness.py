"""Whether residuals are white: sums over rows, and tests on them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hydrabeam_mpi.data.observation import ComplexArray, FloatArray
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock

# A structure counts from this many standard deviations on ...
MIN_SIGMA = 5.0
# ... if it holds more than this share of the power of the residuals beyond the expected noise.
MIN_SHARE = 0.25


class Structure(NamedTuple):
    """A structure in residuals that is not noise: in words, its share of their excess, and its significance."""

    what: str
    share: float
    sigma: float


def whiteness_sums(block: RowBlock, z: ComplexArray) -> FloatArray:
    """Return sums over a block's rows, (5 Nbls + 2 Ntimes + 2,), of whitened residuals z, (Ntimes, Nbls).

    By baseline: number, |z|^2, |z|^4, and z turned by the model's phase, its real and its imaginary part. By time:
    number and |z|^2. And over pairs of rows of one redundant group and time: 2 Re z_1 z_2*, and twice the number.
    """
    observation = block.setup.observation
    used = block.weights > 0
    z = np.where(used, z, 0.0)
    u = np.abs(z) ** 2
    size = np.abs(block.vis)
    turned = z * np.divide(block.vis.conj(), size, out=np.zeros_like(block.vis), where=size > 0)
    by_bl = np.zeros((5, observation.Nbls))
    by_bl[:, block.bls] = [part.sum(axis=0) for part in (used, u, u**2, turned.real, turned.imag)]
    by_time = np.zeros((2, observation.Ntimes))
    by_time[:, block.times] = [part.sum(axis=1) for part in (used, u)]
    order = np.argsort(block.member, kind="stable")
    starts = np.flatnonzero(np.diff(block.member[order], prepend=-1))
    together, number, alone = (np.add.reduceat(part[:, order], starts, axis=1) for part in (z, used.astype(float), u))
    pairs = [np.sum(np.abs(together) ** 2 - alone), np.sum(number * (number - 1))]
    return np.concatenate([by_bl.reshape(-1), by_time.reshape(-1), pairs])


def structure_of(
    setup: ObservingSetup, sums: FloatArray, expected: FloatArray, variance: FloatArray
) -> Structure | None:
    """Return the largest structure of one channel's residuals beyond noise of the given size; None if they are white.

    Parameters
    ----------
    setup : ObservingSetup
    sums : ndarray
        Of `whiteness_sums`, over all rows.
    expected : ndarray, (Nbls,)
        What sum |z|^2 would be at unit variance.
    variance : ndarray, (Nbls,)
        Of z, that white residuals would have.
    """
    n_bls, n_times = setup.observation.Nbls, setup.observation.Ntimes
    counts, power, fourth, real, imag = sums[: 5 * n_bls].reshape(5, n_bls)
    time_counts, time_power = sums[5 * n_bls : -2].reshape(2, n_times)
    total = counts.sum()
    if not total:
        return None
    # What the beam took from the residuals: the same for all structures, and small.
    kept = float(expected.sum() / total)
    excess = float(np.sqrt(counts @ (variance - 1) ** 2 / total))
    mean, mean_square = float(counts @ variance / total), float(counts @ variance**2 / total)
    along = float(np.sum((real**2 + imag**2 - power) / variance)) * mean
    found = [
        _coherence("are alike within redundant groups", float(sums[-2]), float(sums[-1]), mean_square),
        _coherence("follow the model's phase", along, float(np.sum(counts * (counts - 1))), mean**2),
        _uneven_times(time_counts, time_power / kept, mean_square),
        _heavy_tail(total, float(fourth @ variance**-2.0) / kept**2, mean),
    ]
    told = [
        Structure(what, amount / max(excess, 1e-12), sigma)
        for what, amount, sigma in found
        if sigma > MIN_SIGMA and amount > MIN_SHARE * excess
    ]
    return max(told, key=lambda one: one.share, default=None)


def _coherence(what: str, total: float, pairs: float, mean_square: float) -> tuple[str, float, float]:
    """Return power and significance of what pairs of residuals have in common, all sums being twice over pairs."""
    if not pairs:
        return what, 0.0, 0.0
    return what, max(total / pairs, 0.0), total / float(np.sqrt(pairs * mean_square))


def _uneven_times(counts: FloatArray, power: FloatArray, mean_square: float) -> tuple[str, float, float]:
    """Return rms and significance of how the power differs from time to time, beyond chance."""
    what = "are larger at some times than at others"
    used = counts > 0
    if used.sum() < 2:
        return what, 0.0, 0.0
    counts, level = counts[used], power[used] / counts[used]
    deviations = (level - counts @ level / counts.sum()) ** 2 * counts / mean_square
    degrees = len(level) - 1
    beyond = max(float(deviations.sum()) - degrees, 0.0) * mean_square / counts.sum()
    return what, float(np.sqrt(beyond)), float((deviations.sum() - degrees) / np.sqrt(2 * degrees))


def _heavy_tail(total: float, fourth: float, mean: float) -> tuple[str, float, float]:
    """Return rms and significance of how the power differs from row to row, by the mean of |z|^4 = 2 of noise."""
    beyond = fourth / (2 * total) - 1
    return "are large in some rows and small in others", mean * float(np.sqrt(max(beyond, 0.0))), beyond * total**0.5
