"""Effects on the weights of the data rather than on their expectation: noise level and outliers.

No column describes these. They are told by the sizes of the whitened residuals z = r sqrt(w), which in truth have
E|z|^2 = 1, and every one of them is fitted from sums over the rows, which ranks add up.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from hydrabeam_mpi.data.observation import Array, BoolArray, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.effects.interface.row_block import RowBlock
from hydrabeam_mpi.random import complex_normal


@dataclass(frozen=True)
class ReweightingFit:
    """How a reweighting describes the residuals of all channels.

    Attributes
    ----------
    log_bayes_factor : float
        Natural, against the weights as they are, of all channels; not above zero where the data refuse it.
    x, std : ndarray, (Nfreqs, n_params)
        Parameters of each channel and their errors; ``std`` is zero for what is chosen rather than measured.
    names, units : tuple of str
        Of the parameters.
    chi2_drop : float
        Twice the gain in log likelihood at ``x``.
    n_parameters : int
        Number of measured parameters of all channels.
    reason : str, optional
        Why the residuals are not of this kind, where they are not although they deviate.
    levels : ndarray, (Nfreqs, Nbls), optional
        Of each baseline the variance of most of its whitened residuals, one if they are noise. Known where the change
        can be told beside residuals that are larger than noise; see `Reweighting.at_levels`.
    of_fitted : float, optional
        Log Bayes factor of the fitted rows, where the other is of held-out rows as well.
    """

    log_bayes_factor: float
    x: FloatArray
    std: FloatArray
    names: tuple[str, ...]
    units: tuple[str, ...]
    chi2_drop: float
    n_parameters: int
    reason: str | None = None
    levels: FloatArray | None = None
    of_fitted: float | None = None


class Reweighting(ABC):
    """Something that multiplies the inverse noise variance. A plain picklable object without data."""

    kind: ClassVar[str]
    """Name in job files and in ``loop.json``."""
    title: ClassVar[str]
    """Name in sentences."""
    searched_again_with_heavy_tails: ClassVar[bool] = False
    """Whether, where it is refused, it is looked for once more in the residuals of a robust fit."""
    leaves_out: ClassVar[bool] = False
    """Whether it leaves out rows, of which is told where they are."""
    is_of_unknown: ClassVar[bool] = False
    """Whether nobody knows what is in the rows that it leaves out, so that it explains nothing."""
    follows_residuals: ClassVar[bool] = False
    """Whether weights of all rows change with their residuals, so that likelihoods do not compare."""
    weighs_heldout: ClassVar[bool] = False
    """Whether its evidence is of fitted and held-out rows together; see `heldout_sums`."""
    times_refitted: ClassVar[int] = 0
    """How often it is fitted again to the residuals of a fit that has it."""

    @property
    def at_own_level(self) -> bool:
        """Whether it is told beside residuals that are larger than noise, as something else is missing."""
        return False

    def at_levels(self, levels: FloatArray) -> Self | None:
        """Return the change beside residuals that have these variances, (Nfreqs, Nbls); None where it has no such."""
        return None

    @property
    def beside_noise(self) -> Self:
        """The change beside residuals that are noise but for it."""
        return self

    def describe(self) -> dict[str, Any]:
        """Return the settings with which it can be made again."""
        return {}

    def is_told(self, x: FloatArray) -> BoolArray:
        """Return which parameters of ``x``, (Nfreqs, n_params), say something, (n_params,): by default all."""
        return np.ones(x.shape[1], dtype=bool)

    def scales_antennas(self, x: FloatArray) -> bool:
        """Whether parameters, (Nfreqs, n_params), scale the noise of single antennas."""
        return False

    def carried_over(self, setup: ObservingSetup) -> str:
        """Say why it does not hold in other data."""
        return "is about the noise of the data in which it was found"

    @abstractmethod
    def sizes(self, setup: ObservingSetup) -> tuple[int, ...]:
        """Return how many parameters a channel may have."""

    @abstractmethod
    def neutral(self, setup: ObservingSetup) -> dict[str, float]:
        """Return the names of all parameters that a channel may have, and the values that change nothing."""

    @abstractmethod
    def n_sums(self, setup: ObservingSetup) -> int:
        """Return the number of `sums`."""

    @abstractmethod
    def sums(self, block: RowBlock, z: ComplexArray) -> FloatArray:
        """Return what `fit` needs of a block's rows, (n_sums,): additive over rows, so over blocks and ranks.

        Parameters
        ----------
        block : RowBlock
            Whole redundant groups at each of its times. Rows whose weight is zero do not count.
        z : ndarray of complex, (Ntimes, Nbls)
            Residuals times the square roots of the weights.
        """

    def heldout_sums(self, setup: ObservingSetup, times: IntArray, bls: IntArray, z: ComplexArray) -> FloatArray:
        """Return what `fit` needs of held-out rows where these count, (n_sums,): additive as well.

        Parameters
        ----------
        setup : ObservingSetup
        times : ndarray of int, (Ntimes,)
        bls : ndarray of int, (Nbls,)
        z : ndarray of complex, (Ntimes, Nbls)
            Residuals over the errors of their prediction, E|z|^2 = 1; zero where there are none.
        """
        return np.zeros(self.n_sums(setup))

    @abstractmethod
    def fit(self, setup: ObservingSetup, sums: FloatArray, effective_parameters: FloatArray) -> ReweightingFit:
        """Weigh the evidence.

        Parameters
        ----------
        setup : ObservingSetup
        sums : ndarray, (Nfreqs, n_sums)
            Of all rows of each channel.
        effective_parameters : ndarray, (Nfreqs,) or (Nfreqs, Nbls)
            How many real parameters of the beam the rows have decided, by which sum |z|^2 falls short of the number
            of rows by half as many; zero for rows that were not fitted. Either in all, which are shared out by the
            number of rows, or those of each baseline: its sum over times of 2 w a^H P a with a the row of the
            beam's design and P the posterior covariance.
        """

    @abstractmethod
    def weight_factor(self, block: RowBlock, x: FloatArray) -> FloatArray:
        """Return what multiplies the inverse noise variance, (Ntimes, Nbls).

        Parameters
        ----------
        block : RowBlock
            With weights that this reweighting has not changed yet.
        x : ndarray, (n_params,)
            Of the block's channel.
        """

    def price(self, setup: ObservingSetup, channel: int, times: IntArray, bls: IntArray, x: FloatArray) -> FloatArray:
        """Return what it costs in ln likelihood to leave out a row, (Ntimes, Nbls): by default nothing.

        That is |z|^2 where a row is just left out, so that the likelihood has no jump where rows come and go in a fit;
        infinite for rows that it does not leave out whatever their residual. ``x``, (n_params,), is the channel's.
        """
        return np.zeros((len(times), len(bls)))

    @abstractmethod
    def draw(self, setup: ObservingSetup, rng: np.random.Generator, strength: float) -> FloatArray:
        """Draw one channel's parameters to simulate with, (n_params,); nothing happens at strength zero."""

    @abstractmethod
    def inject(self, data: ComplexArray, block: RowBlock, x: FloatArray, rng: np.random.Generator) -> ComplexArray:
        """Return simulated data with this effect, which their weights do not account for, (Ntimes, Nbls), Jy.

        Parameters
        ----------
        data : ndarray of complex, (Ntimes, Nbls)
            With the noise that ``block.weights`` stand for.
        """


def with_more_noise(data: ComplexArray, block: RowBlock, more: FloatArray, rng: np.random.Generator) -> ComplexArray:
    """Return data, (Ntimes, Nbls), with noise of ``more`` times the variance that the weights stand for added."""
    return data + std_of_more(block, more) * complex_normal(rng, block.shape)


def std_of_more(block: RowBlock, more: FloatArray) -> FloatArray:
    """Return the standard deviation of ``more`` times the variance that the weights stand for, (Ntimes, Nbls), Jy."""
    used = block.weights > 0
    return np.sqrt(np.where(used, np.maximum(more, 0.0) / np.where(used, block.weights, 1.0), 0.0))


def fitted_counts(counts: FloatArray, effective_parameters: Array) -> FloatArray:
    """Return what sum |z|^2 should be of each baseline, (Nbls,): its rows less what the beam took.

    Parameters
    ----------
    counts : ndarray, (Nbls,)
        Numbers of rows.
    effective_parameters : ndarray, () or (Nbls,)
        Of one channel; see `Reweighting.fit`.
    """
    share = np.asarray(effective_parameters, dtype=float)
    if share.ndim == 0:
        share = share * counts / max(float(counts.sum()), 1.0)
    # Never zero: a baseline that the beam fits entirely says little of the noise, but does not prove that there is
    # none.
    return np.asarray(np.maximum(counts - 0.5 * share, 0.01 * counts))
