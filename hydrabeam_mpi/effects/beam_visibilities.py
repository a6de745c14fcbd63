"""What the current beam sees on vectors that are not those of a scene's groups."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hydrabeam_mpi.data.observation import Array, ComplexArray, FloatArray, IntArray
from hydrabeam_mpi.effects.experiment import Experiment
from hydrabeam_mpi.effects.scene import Scene
from hydrabeam_mpi.model.bases.base import LinearBasis
from hydrabeam_mpi.model.rime import Beam

FEW = 4
"""Vectors up to which the visibilities of all modes, which serve any beam, are worth their making and their room."""


@dataclass(frozen=True)
class InferredBeam:
    """A beam by its coefficients in the basis.

    Attributes
    ----------
    basis : LinearBasis
    coeffs : ndarray, (n_modes,)
    """

    basis: LinearBasis
    coeffs: Array

    def __call__(self, za: FloatArray, az: FloatArray) -> Array:
        """Evaluate it, (Npoints,)."""
        return np.asarray(self.basis.synthesize(self.coeffs, za, az))


def beam_visibilities(scene: Scene, vectors: FloatArray) -> ComplexArray:
    """Integrate the current beam over the sky, once for a scene.

    Parameters
    ----------
    scene : Scene
        Keeps the result for as long as it has the same beam and times.
    vectors : ndarray, (N, 3)
        Baseline vectors, metres ENU; zero for autocorrelations.

    Returns
    -------
    ndarray of complex, (Ntimes, N)
        Jy.
    """
    kept: dict[bytes, tuple[Beam, IntArray, ComplexArray]] = vars(scene).setdefault("_beam_visibilities", {})
    key = vectors.tobytes()
    if key in kept:
        beam, times, values = kept[key]
        if beam is scene.beam and times is scene.times:
            return values
    lasts = scene.memo is not None and not scene.sky_effects
    if lasts and isinstance(scene.beam, InferredBeam) and len(vectors) <= FEW:
        basis = scene.beam.basis
        modes = scene.fixed_integral(f"modes on {key!r}", lambda at: basis.columns(at.za, at.az), vectors)
        integrals = modes @ basis.column_coeffs(scene.beam.coeffs).real
    else:
        integrals = scene.integrate(lambda sources: sources.beam[np.newaxis], vectors)
    # Without times `integrals` has lost its axes.
    values = integrals.reshape(len(scene.times), len(vectors)).astype(complex)
    kept[key] = scene.beam, scene.times, values
    return values


def is_copolar(experiment: Experiment) -> bool:
    """Tell whether the data are products of equal feeds, of which the model also has autocorrelations."""
    pol = experiment.observation.pols[0]
    return pol[0] == pol[1]
