"""Errors of what has been fitted, where more is left of the fitted data than the noise that their weights state.

Then the variance of the data counts as unknown up to a common factor, for which the reduced chi^2 of the residual is
the best estimate as long as nobody knows what is left. Errors are larger by its root. Values stay, and so does what is
written for computing them again.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.state import Active, Fitted
from hydrabeam_mpi.mpi import allreduce_sum


@dataclass(frozen=True)
class ErrorScale:
    """By how much errors are larger than the stated noise alone makes them.

    Attributes
    ----------
    channels : ndarray, (Nfreqs,)
        Of parameters of a channel; one where what is left is no more than noise.
    together : float
        Of parameters that all channels share.
    """

    channels: FloatArray
    together: float

    def of(self, one: Active, std: FloatArray) -> FloatArray:
        """Return the standard deviations of an effect's parameters, (Nfreqs, n_params), from those by noise alone."""
        return std * self.of_blocks(one.effect)[:, np.newaxis]

    def of_blocks(self, effect: Effect) -> FloatArray:
        """Return the scale of each set of an effect's parameters: (1,) if channels share one, else (Nfreqs,)."""
        return np.array([self.together]) if effect.shared else self.channels


def error_scale(context: FitContext, fitted: Fitted) -> ErrorScale:
    """Return the root of the reduced chi^2 of the fitted rows where it is above one by more than its sampling error.

    It counts degrees of freedom: of n complex data, less half of the real parameters that they decided, chi^2 has a
    standard error of their root. Collective: all ranks of the grid.
    """
    chi2, free = _by_channel(context, fitted)
    return ErrorScale(_root_of_excess(chi2, free), float(_root_of_excess(chi2.sum(), free.sum())))


class Left(NamedTuple):
    """What a fit leaves: chi^2 of all fitted rows, not reduced, and how much of it is ``free``: what noise leaves.

    That is one of each complex datum, so that ln likelihood rises by as much as chi^2 falls.
    """

    chi2: float
    free: float

    @property
    def above_noise(self) -> float:
        """By how much ln likelihood may still rise."""
        return max(self.chi2 - self.free, 0.0)

    def over_noise(self, chi2_drop: float = 0.0) -> float:
        """Return the variance of what is left over that of the noise, at least one.

        So it is once twice ln likelihood has risen by ``chi2_drop``, as the linear model expects of an effect.
        """
        return max((self.chi2 - 0.5 * chi2_drop) / self.free, 1.0)


def left_of(context: FitContext, fitted: Fitted) -> Left:
    """Return what a fit leaves. Collective: all ranks of the grid."""
    chi2, free = _by_channel(context, fitted)
    return Left(float(chi2.sum()), float(free.sum()))


def _by_channel(context: FitContext, fitted: Fitted) -> tuple[FloatArray, FloatArray]:
    """Return each channel's chi^2 and degrees of freedom, (Nfreqs,). Collective: all ranks of the grid."""
    n_freqs, own = context.setup.observation.Nfreqs, fitted.diagnostics
    chi2, free = np.zeros(n_freqs), np.zeros(n_freqs)
    if context.grid.is_group_root:
        mine = context.channels
        chi2[mine] = own.train_chi2 * own.n_data
        free[mine] = np.maximum(own.n_data - 0.5 * (own.effective_parameters + _decided(fitted, n_freqs)[mine]), 1.0)
    for part in (chi2, free):
        allreduce_sum(context.grid.world, part)
    return chi2, free


def _decided(fitted: Fitted, n_freqs: int) -> FloatArray:
    """Return how many of the effects' parameters the data have decided, tr(C K) = q - tr(C / T), a channel's part."""
    decided = np.zeros(n_freqs)
    for one, std in zip(fitted.values.active, fitted.fit.std, strict=True):
        prior = np.array([one.prior.of(f).std() for f in range(n_freqs)])
        of_channel = np.sum(1 - np.minimum(std[:, one.used] / prior, 1.0) ** 2, axis=1)
        decided += of_channel / (n_freqs if one.effect.shared else 1)
    return decided


def _root_of_excess(chi2: FloatArray, free: FloatArray) -> FloatArray:
    return np.sqrt(np.where(chi2 > free + np.sqrt(free), chi2 / free, 1.0))
