"""What an ensemble of beams says about coefficients: their mean and covariance, as a prior.

An ensemble has far fewer beams than a basis has modes, so the sample covariance S is singular. It is shrunk
towards its own diagonal, (1 - lambda) S + lambda diag(S), with the intensity lambda that minimises the
expected squared error (Schaefer & Strimmer 2005, target D); a ridge is added for what fits leave over.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.model.bases.base import LinearBasis
from hydrabeam_mpi.model.fit import Evaluable, beam_pixels, fit_basis


@dataclass(frozen=True)
class CoefficientEnsemble:
    """Mean and covariance of the coefficients of an ensemble of beams.

    Attributes
    ----------
    mean : ndarray, (n_modes,)
    covariance : ndarray, (n_modes, n_modes)
        Hermitian, positive definite.
    shrinkage : float
        lambda, from 0 (sample covariance) to 1 (its diagonal).
    ridge : float
        Variance added to every coefficient.
    n_beams : int
    """

    mean: Array
    covariance: Array
    shrinkage: float
    ridge: float
    n_beams: int


def fit_ensemble(beams: Iterable[Evaluable], basis: LinearBasis) -> tuple[Array, FloatArray]:
    """Fit every beam by the same basis.

    Returns
    -------
    coeffs : ndarray, (n_beams, n_modes)
    rms_residuals : ndarray, (n_beams,)
    """
    fits = [fit_basis(basis, beam_pixels(beam)) for beam in beams]
    return np.array([fit.coeffs for fit in fits]), np.array([fit.rms_residual for fit in fits])


def summarise_ensemble(coeffs: Array, ridge: float) -> CoefficientEnsemble:
    """Estimate mean and covariance.

    Parameters
    ----------
    coeffs : ndarray, (n_beams, n_modes)
    ridge : float
        Variance added to every coefficient; must be positive if some coefficient is the same in all beams.

    Raises
    ------
    InputError
        If there are fewer than three beams, or the covariance is not positive definite.
    """
    n_beams = len(coeffs)
    if n_beams < 3:
        raise InputError(f"{n_beams} beams do not give a covariance", field="ensemble", remedy="give three or more")
    mean = coeffs.mean(axis=0)
    centred = coeffs - mean
    variance = np.sum(np.abs(centred) ** 2, axis=0) / (n_beams - 1)
    if variance.min() + ridge <= 0:
        message = "a coefficient is the same in all beams, which would fix it"
        raise InputError(message, field="ridge", remedy="give a positive ridge")
    covariance = centred.T @ centred.conj() / (n_beams - 1)
    shrinkage = _shrinkage(centred)
    covariance *= 1 - shrinkage
    np.fill_diagonal(covariance, variance + ridge)
    return CoefficientEnsemble(mean, covariance, shrinkage, ridge, n_beams)


def _shrinkage(centred: Array) -> float:
    """Return sum Var(s_ij) / sum |s_ij|^2 over i != j, for coefficients scaled to unit variance."""
    n_beams = len(centred)
    scale = np.sqrt(np.mean(np.abs(centred) ** 2, axis=0))
    scaled = centred / np.where(scale > 0, scale, 1)
    power = np.abs(scaled) ** 2
    mean_squared = np.abs(scaled.T @ scaled.conj() / n_beams) ** 2
    squared_mean = power.T @ power / n_beams
    np.fill_diagonal(mean_squared, 0)
    np.fill_diagonal(squared_mean, 0)
    noise = (squared_mean - mean_squared).sum() / (n_beams - 1)
    signal = mean_squared.sum()
    return float(np.clip(noise / signal, 0, 1)) if signal > 0 else 1.0
