"""The noise of visibilities: what its variances have in common, and whether outliers are part of it.

A baseline's variance is the stated one times the scales of what it is made of: of both its antennas,
sigma_jk^2 -> s_j s_k sigma_jk^2, since by the radiometer equation it is the product of their system temperatures; or of
the baselines as long as it is. Given all other scales each of them then scales variances, so that it has an inverse
gamma of its own.

Noise of Student's t with nu degrees of freedom is Gaussian noise with a weight l ~ Gamma(nu / 2, rate nu / 2) of each
visibility on top of the stated one. Of q = |r|^2 / sigma^2 of a complex residual

    l | r ~ Gamma(nu / 2 + 1, rate nu / 2 + q),        p(r) = (1 + 2 q / nu)^(-nu / 2 - 1) / (pi sigma^2).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray, IntArray
from hydrabeam_mpi.data.partition import Tile
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.fit.accumulate import seen_by
from hydrabeam_mpi.fit.rank_data import RankData
from hydrabeam_mpi.fit.state import Estimate
from hydrabeam_mpi.sampling.state import Chance


@dataclass(frozen=True)
class InverseGamma:
    """The prior of a scale v of a variance: p(v) ~ v^(-shape - 1) exp(-scale / v)."""

    shape: float
    scale: float

    def drawn_given(self, n: float, power: float, rng: np.random.Generator) -> float:
        """Draw v where n complex numbers of variance v have the sum of squares ``power`` together."""
        return float((self.scale + power) / rng.gamma(self.shape + n))


@dataclass(frozen=True)
class NoiseParts:
    """What of a baseline has a scale of its noise's variance.

    Attributes
    ----------
    name : {"antenna", "length"}
    labels : tuple
        Numbers of the antennas, or lengths in m; (n_parts,).
    of_baseline : ndarray of int, (n_factors, Nbls)
        The parts whose scales are multiplied.
    """

    name: str
    labels: tuple[float, ...]
    of_baseline: IntArray

    @classmethod
    def of(cls, name: Literal["antenna", "length"], setup: ObservingSetup, tolerance: float) -> NoiseParts:
        """Find them; lengths that differ by less than ``tolerance``, in m, are one."""
        observation, redundant = setup.observation, setup.redundant
        if name == "antenna":
            there, of_baseline = np.unique(observation.antpairs, return_inverse=True)
            return cls(name, tuple(there.tolist()), of_baseline.reshape(-1, 2).T)
        lengths = np.linalg.norm(redundant.vectors, axis=1)
        order = np.argsort(lengths)
        numbers = np.empty(len(order), dtype=int)
        numbers[order] = np.cumsum(np.diff(lengths[order], prepend=lengths[order][0]) > tolerance)
        means = np.bincount(numbers, lengths) / np.bincount(numbers)
        return cls(name, tuple(means.tolist()), numbers[redundant.group][np.newaxis])

    def scale(self, parts: FloatArray) -> FloatArray:
        """Return by what the variances of baselines exceed the stated ones, (..., Nbls), of (..., n_parts)."""
        return np.asarray(np.prod(parts[..., self.of_baseline], axis=-2))


def squared_residuals(share: RankData, at: Estimate) -> tuple[FloatArray, FloatArray]:
    """Return w |r|^2 of a rank's rows, and the weights w of the data as they were read; (Nlocal, Ntimes, Nbls) each.

    Serial.
    """
    rows, _ = share.calibrated(at)
    found, weights = np.empty(rows.data.shape), rows.inv_noise_var
    for t, design in enumerate(share.designs(at.values)):
        for f, beam in enumerate(at.beams):
            residual = rows.data[f, t] - seen_by(design[f], beam.mean)[rows.member]
            found[f, t] = weights[f, t] * np.abs(residual) ** 2
    divisor = np.ones_like(weights) if rows.divisor is None else rows.divisor
    return found, np.divide(weights, divisor, out=np.zeros_like(weights), where=weights > 0)


def log_densities(squares: FloatArray, weights: FloatArray, dof: float | None) -> FloatArray:
    """Return ln p of visibilities with such q and 1 / sigma^2; zero for those that do not count."""
    used = weights > 0
    told = -squares if dof is None else -(0.5 * dof + 1) * np.log1p(2 * squares / dof)
    return np.where(used, np.log(np.where(used, weights, 1.0) / np.pi) + told, 0.0)


def drawn_weights(
    squares: FloatArray, dof: float, chance: Chance, channels: list[int], tile: Tile, n_bls: int
) -> FloatArray:
    """Draw the weight l of each of a rank's visibilities given its q, (Nlocal, Ntimes, Nbls)."""
    drawn = np.empty(squares.shape)
    for f, channel in enumerate(channels):
        for t, time in enumerate(tile.times.tolist()):
            # Of all baselines, whichever of them are this rank's.
            gammas = chance.of("weights", channel, time).standard_gamma(0.5 * dof + 1, n_bls)
            drawn[f, t] = gammas[tile.bls] / (0.5 * dof + squares[f, t])
    return drawn
