"""The model as the loop has it so far: the beams and the effects that are part of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydrabeam_mpi.data.observation import FloatArray
from hydrabeam_mpi.effects.interface.effect import Effect
from hydrabeam_mpi.effects.interface.observing_setup import ObservingSetup
from hydrabeam_mpi.infer.posterior import Posterior


@dataclass
class Active:
    """An effect that is part of the model.

    Attributes
    ----------
    effect : Effect
    prior_var : ndarray, (n_params,)
        Prior variance of each parameter about zero; zero for those that are held at zero.
    x : ndarray, (Nfreqs, n_params)
        Current values, of all the job's channels; shared parameters are repeated.
    std : ndarray, (Nfreqs, n_params)
        Posterior standard deviations.
    step_limit : ndarray, (n_params,)
        Largest step of one Gauss-Newton iteration.
    degenerate_directions : ndarray, (n, n_params)
        Combinations of parameters that are held at zero.
    """

    effect: Effect
    prior_var: FloatArray
    x: FloatArray
    std: FloatArray
    step_limit: FloatArray
    degenerate_directions: FloatArray

    @classmethod
    def start(cls, effect: Effect, setup: ObservingSetup, prior_var: FloatArray, x: FloatArray) -> Active:
        """Begin with ``x``, (Nblocks, n_params); elements in use bring their `nonlinear` parameters with them.

        The prior of those has three times their natural size.
        """
        parameters = effect.parameters(setup)
        nonlinear = parameters.nonlinear & np.isin(parameters.element, parameters.element[prior_var > 0])
        n_freqs = setup.observation.Nfreqs
        held = effect.degenerate_directions(setup)
        free = np.all((prior_var > 0) | (held == 0), axis=1)
        held = held[free]
        x = x - (x @ np.linalg.pinv(held)) @ held
        return cls(
            effect,
            np.where(nonlinear, (3 * parameters.scale) ** 2, prior_var),
            np.broadcast_to(x, (n_freqs, len(parameters))).copy(),
            np.zeros((n_freqs, len(parameters))),
            np.where(parameters.nonlinear, parameters.scale, np.inf),
            held,
        )

    @property
    def kind(self) -> str:
        """The effect's name."""
        return self.effect.kind

    @property
    def used(self) -> NDArray[np.intp]:
        """Indices of the parameters that are not held at zero."""
        return np.flatnonzero(self.prior_var)


@dataclass
class Reweighted:
    """A change of the weights that is part of the model, parameters (Nfreqs, n_params)."""

    change: Any
    x: FloatArray
    std: FloatArray


@dataclass
class State:
    """Beams and effects.

    Attributes
    ----------
    active : list of Active
    reweighted : list of Reweighted
    posteriors : list of Posterior
        Of this rank group's channels, given the effects.
    covariances : list of ndarray
        Posterior covariance of all active parameters in use, side by side, of this rank group's channels.
    beam_response : list of ndarray, (n_modes, q)
        By how much the beam's coefficients move when one of these parameters does.
    train_chi2 : ndarray, (Nlocal,)
        Reduced chi^2 of the fitted rows, this rank group's channels.
    log_joint : ndarray, (Nlocal,)
        Logarithm of the likelihood of the fitted rows times the prior of the beam at its mean, up to a constant.
    effective_parameters : ndarray, (Nlocal,)
        How many real parameters of the beam the fitted rows have decided, tr(P^-1 F^H N^-1 F); on group roots.
    """

    active: list[Active] = field(default_factory=list)
    reweighted: list[Reweighted] = field(default_factory=list)
    posteriors: list[Posterior] = field(default_factory=list)
    covariances: list[FloatArray] = field(default_factory=list)
    beam_response: list[NDArray[Any]] = field(default_factory=list)
    train_chi2: FloatArray = field(default_factory=lambda: np.zeros(0))
    log_joint: FloatArray = field(default_factory=lambda: np.zeros(0))
    effective_parameters: FloatArray = field(default_factory=lambda: np.zeros(0))

    def extended(self, active: Active) -> State:
        """Return the state with one more effect, not yet fitted."""
        return State([*self.active, active], list(self.reweighted), list(self.posteriors))

    @property
    def shared(self) -> NDArray[np.bool_]:
        """Whether channels share each of the active parameters in use, side by side."""
        return np.concatenate(
            [np.zeros(0, dtype=bool), *(np.full(len(one.used), one.effect.shared) for one in self.active)]
        )

    @property
    def prior_var(self) -> FloatArray:
        """Prior variances of all active parameters in use, side by side."""
        return np.concatenate([np.zeros(0), *(one.prior_var[one.used] for one in self.active)])
