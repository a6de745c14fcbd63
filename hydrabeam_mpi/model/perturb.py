"""A slightly wrong beam to simulate with: the perturbation of HDBI II, section 3.

    B_pert(za, az) = g(rho') B(rho', az),        rho' = rho sqrt((cos az / a)^2 + (sin az / b)^2)
    g = 1 + sigma_SL c_SL h K                    K = sum_{n=1}^{8} c_n sin(2 pi alpha n rho')

The main lobe is widened by a along East-West and by b along North-South; the sidelobes, where h has turned
on, are modulated by at most sigma_SL in all.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hydrabeam_mpi.data.observation import Array, FloatArray
from hydrabeam_mpi.errors import InputError
from hydrabeam_mpi.model.bases.disc import EDGE
from hydrabeam_mpi.model.beam import Beam, BeamInfo
from hydrabeam_mpi.random import generator

_N_SINES = 8
_TURN_ON = np.pi / 10
_TURN_ON_WIDTH = np.pi / 60


@dataclass(frozen=True)
class PerturbedBeam:
    """A beam stretched along two axes, with its sidelobes modulated.

    Attributes
    ----------
    base : Beam
        The beam that is perturbed.
    seed : int
        Of the eight amplitudes c_n, standard normal.
    stretch : tuple of float
        a (East-West) and b (North-South); below one by so little at most that the horizon stays within the rim.
    sigma_sl : float
        Range of the modulation of the sidelobes.
    edge : float
        Zenith angle at which rho = 1, radians.
    """

    base: Beam
    seed: int
    stretch: tuple[float, float] = (1.01, 1.02)
    sigma_sl: float = 0.2
    edge: float = EDGE

    def __post_init__(self) -> None:
        """Refuse to shrink the beam so much that the horizon comes from beyond the base's rim."""
        smallest = np.sin(np.pi / 4) / np.sin(self.edge / 2)
        if min(self.stretch) < smallest:
            message = f"stretch {self.stretch} takes the horizon from beyond the rim of the beam"
            raise InputError(message, field="stretch", remedy=f"use {smallest:.4f} or more along each axis")

    @property
    def info(self) -> BeamInfo:
        """The base's, with a name that says what was done."""
        a, b = self.stretch
        change = f"stretched by {a:g}, {b:g}, sidelobes modulated by {self.sigma_sl:g}, seed {self.seed}"
        return replace(self.base.info, name=f"{self.base.info.name}, {change}")

    def __call__(self, za: FloatArray, az: FloatArray) -> Array:
        """Evaluate the perturbed beam, (Npoints,)."""
        a, b = self.stretch
        ellipse = np.sqrt((np.cos(az) / a) ** 2 + (np.sin(az) / b) ** 2)
        # alpha rho' = sqrt(1 - cos za') = sqrt(2) sin(za'/2), without the loss of digits near the zenith.
        radius = np.sqrt(2) * np.sin(0.5 * np.asarray(za)) * ellipse
        stretched_za = 2 * np.arcsin(radius / np.sqrt(2))
        turn_on = 0.5 * (1 + np.tanh((stretched_za - _TURN_ON) / _TURN_ON_WIDTH))
        gain = 1 + self.sigma_sl * self._modulation_scale * turn_on * self._modulation(radius)
        return gain * self.base(stretched_za, np.asarray(az))

    @cached_property
    def _amplitudes(self) -> FloatArray:
        return generator(self.seed, "beam perturbation").standard_normal(_N_SINES)

    @cached_property
    def _modulation_scale(self) -> float:
        """The paper's c_SL: one over the range of K for rho' in 0..1."""
        modulation = self._modulation(np.sqrt(1 - np.cos(self.edge)) * np.linspace(0, 1, 10001))
        return float(1 / np.ptp(modulation))

    def _modulation(self, radius: FloatArray) -> FloatArray:
        """Return the paper's K at ``radius`` = alpha rho'."""
        order = np.arange(1, _N_SINES + 1)
        return self._amplitudes @ np.sin(2 * np.pi * order[:, None] * radius)
