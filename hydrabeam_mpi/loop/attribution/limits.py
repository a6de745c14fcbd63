"""What of an effect cannot be, such as fluxes below zero, judged where the linear model has its optimum.

A Gaussian prior knows no limits, so that dozens of sources with fluxes of either sign can stand for a missing one, and
have more evidence than it has beside its place. What cannot be is left out before effects are compared.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from hydrabeam_mpi.data.observation import BoolArray, FloatArray, IntArray
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.fit.context import FitContext
from hydrabeam_mpi.fit.error_scale import Left, left_of
from hydrabeam_mpi.fit.state import Fitted
from hydrabeam_mpi.loop.attribution.evidence import Evidence


def is_unphysical(beyond: FloatArray, nats: float) -> BoolArray:
    """Whether what is ``beyond`` its limit by so many standard errors is so by more than errors allow, (n_params,).

    At the limit ln likelihood is less by beyond^2 / 2. It is unphysical if that is more than the evidence, ``nats``,
    for which anything is believed.
    """
    return np.asarray(0.5 * beyond**2 > nats)


@dataclass(frozen=True)
class Limits:
    """What the parameters of effects may be.

    Attributes
    ----------
    setup : ObservingSetup
    nats : float
        Evidence for which anything is believed.
    left : Left
        What is left of the fitted rows.
    """

    setup: ObservingSetup
    nats: float
    left: Left

    @classmethod
    def of(cls, context: FitContext, fitted: Fitted) -> Self:
        """Judge by what is left of the fitted rows. Collective: all ranks of the grid."""
        return cls(context.setup, context.problem.job.loop.min_log_bayes_factor, left_of(context, fitted))

    def beyond(self, effect: Effect, which: IntArray, found: Evidence) -> BoolArray:
        """Return which of some of an effect's parameters, ``which``, are beyond its limits, (q,).

        Errors count what is left of the data, as everywhere (`error_scale`). Of what has places or indices to fit,
        which are nonlinear, nothing is known before a fit.
        """
        parameters = effect.parameters(self.setup)
        if np.any(parameters.nonlinear):
            return np.zeros(len(which), dtype=bool)
        x, std = np.zeros((2, self.setup.observation.Nfreqs, len(parameters)))
        x[:, which] = found.x
        std[:, which] = found.std * np.sqrt(self.left.over_noise(found.chi2_drop))
        return is_unphysical(effect.beyond(self.setup, x, std), self.nats)[which]
