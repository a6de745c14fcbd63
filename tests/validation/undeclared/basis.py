"""The functions in which the job describes the beam."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import j0, jn_zeros

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Basis:
    """Bessel functions of rho = sqrt(1 - cos za) / sqrt(1 - cos edge), times sines and cosines of the azimuth.

    Attributes
    ----------
    form : str
        "real" or "complex" coefficients.
    k_max, m_max : int
        Radial and azimuthal orders.
    edge : float
        Degrees of zenith angle.
    boundary : str
        "neumann", flat at the edge, or "dirichlet", zero there.
    """

    form: str
    k_max: int
    m_max: int
    edge: float
    boundary: str

    @property
    def n_modes(self) -> int:
        """All that there are of these orders."""
        return self.k_max * (2 * self.m_max + 1)

    def modes(self, za: FloatArray, az: FloatArray) -> FloatArray:
        """Evaluate the functions, whose span over the complex numbers is that of the job's, (n_modes, Npoints)."""
        if self.boundary == "neumann":
            zeros = np.concatenate([[0.0], jn_zeros(1, self.k_max - 1)])
        else:
            zeros = jn_zeros(0, self.k_max)
        rho = np.sqrt((1 - np.cos(za)) / (1 - np.cos(np.deg2rad(self.edge))))
        azimuthal = [np.ones_like(az)]
        for m in range(1, self.m_max + 1):
            azimuthal += [np.cos(m * az), np.sin(m * az)]
        radial = j0(zeros[:, np.newaxis] * rho)
        return (radial[:, np.newaxis] * np.array(azimuthal)).reshape(-1, len(za))


BASES = {
    "study": Basis("real", 12, 4, 90.0, "neumann"),
    "default": Basis("real", 24, 4, 92.0, "neumann"),
    "paper": Basis("complex", 24, 4, 92.0, "dirichlet"),
}
"""What a job may have: functions that suit the study's beams, and the kinds of functions, of edge and of coefficients
that the package takes where the job has no wish, and that the paper has. Their orders are fewer than in either, as the
array is smaller, but twice the study's along the radius: functions that end below the horizon, and at zero, need them
to follow these beams to below the noise."""
