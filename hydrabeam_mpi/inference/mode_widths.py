"""How wide the prior of each function's coefficient is, by what the model's coefficients are and by its orders."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray, IntArray


@dataclass(frozen=True)
class PriorWidths:
    """How wide a prior of independent coefficients is: in proportion to those of the model, and a smooth part beside.

    The smooth part is what a beam may have where its model has little: largest at the lowest orders, by which it falls.

    Attributes
    ----------
    fraction : float
        Standard deviation over the amplitude of the model's coefficient.
    amplitude : float
        Standard deviation of the smooth part at the lowest orders, over the largest amplitude of the model.
    decay : (float, float)
        ln of how much less the smooth part is for each radial and each azimuthal order.
    neighbours : bool
        Whether the amplitude is the largest of the coefficient and of those beside it, see `ModeSizes.envelope`.
    azimuthal : tuple of float
        Factors of the widths at azimuthal orders 0, 1, 2 and so on; beyond these widths are as they are.
    """

    fraction: float = 1.0
    amplitude: float = 0.0
    decay: tuple[float, float] = (0.0, 0.0)
    neighbours: bool = False
    azimuthal: tuple[float, ...] = ()


@dataclass(frozen=True)
class ModeSizes:
    """What the widths of coefficients follow from.

    Attributes
    ----------
    amplitudes : ndarray, (n,)
        Of the model's coefficients.
    orders : ndarray of int, (n, 2)
        Radial and azimuthal ones, from zero on.
    largest : float
        Amplitude of the model.
    """

    amplitudes: FloatArray
    orders: IntArray
    largest: float

    def widths(self, by: PriorWidths) -> tuple[FloatArray, FloatArray]:
        """Return the two parts of the standard deviations, of which the squares are added, (n,) each."""
        azimuthal = self.orders[:, 1]
        factors = np.ones(1 + max(len(by.azimuthal), int(azimuthal.max())))
        factors[: len(by.azimuthal)] = by.azimuthal
        of_all = factors[azimuthal]
        smooth = by.amplitude * self.largest * np.exp(-self.orders @ np.array(by.decay))
        return by.fraction * of_all * (self.envelope if by.neighbours else self.amplitudes), of_all * smooth

    @cached_property
    def envelope(self) -> FloatArray:
        """The largest amplitude at each coefficient's and the adjacent radial orders, azimuthal order the same, (n,).

        A beam that is a bit wider than its model has in each coefficient something of those beside it, also where the
        model's own passes through zero.
        """
        radial, azimuthal = self.orders.T
        largest = np.zeros((radial.max() + 3, azimuthal.max() + 1))
        np.maximum.at(largest, (radial + 1, azimuthal), self.amplitudes)
        return np.asarray(np.max([largest[radial + step, azimuthal] for step in range(3)], axis=0))
