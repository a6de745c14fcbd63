"""Widths of the beam's prior as the numbers that evidence is told by, and what is known of these beforehand."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hydrabeam_mpi.config.sections import LEAST_WIDTH, MOST_DECAY
from hydrabeam_mpi.data.observation import FloatArray, IntArray
from hydrabeam_mpi.fit.scoring import Told
from hydrabeam_mpi.inference.mode_widths import PriorWidths

TYPICAL = PriorWidths(0.1, 1e-3)
"""Coefficients of models are right within a tenth, and what models lack is a thousandth of the largest ..."""
SPREAD = 2 * float(np.log(10.0))
"""... both within a factor of a hundred: ln of them is Gaussian. Evidence alone would give a beam that the data do not
tell from its model no width at all, and errors of zero."""
DECAY = 1.0
"""Scale of the prior of decays, half a Gaussian: a factor e for each order is as fast as feeds with one lobe have."""
UNEVEN = float(np.log(10.0))
"""Azimuthal orders differ by a factor of ten: a dish that is out of round has the second one and no other."""
LEAST, MOST = LEAST_WIDTH, 1e3
"""Of fraction, amplitude and factors; the smooth part is left out where it is least."""
N_SHARED = 4
"""Fraction, amplitude and two decays come first; they are shared by all azimuthal orders."""


@dataclass(frozen=True)
class WidthNumbers:
    """Fraction and smooth amplitude by their logarithms, decays, and ln of a factor for each azimuthal order.

    Attributes
    ----------
    counts : ndarray of int, (n_azimuthal,)
        How many coefficients have each azimuthal order, 0, 1, 2 and so on, in all channels together.
    """

    counts: IntArray

    def of(self, widths: PriorWidths) -> FloatArray:
        """Return the numbers of widths, (4 + n_azimuthal,)."""
        shared = [np.log(widths.fraction), np.log(max(widths.amplitude, LEAST)), *widths.decay]
        factors = np.zeros(len(self.counts))
        known = np.log(widths.azimuthal[: len(factors)])
        factors[: len(known)] = known
        return np.array([*shared, *factors])

    def widths(self, numbers: FloatArray) -> PriorWidths:
        """Return the widths that numbers stand for."""
        fraction, amplitude = np.exp(numbers[:2]).tolist()
        factors = numbers[N_SHARED:]
        azimuthal = tuple(np.exp(factors).tolist()) if np.any(factors) else ()
        if not amplitude > 1.001 * LEAST:
            return PriorWidths(fraction, neighbours=True, azimuthal=azimuthal)
        decay = float(numbers[2]), float(numbers[3])
        return PriorWidths(fraction, amplitude, decay, neighbours=True, azimuthal=azimuthal)

    def bounds(self, stated: PriorWidths, wider: bool, uneven: bool) -> FloatArray:
        """Return least and largest numbers, (2, n); with ``wider`` no width may be less than the stated one.

        Azimuthal orders have factors of their own where they may be ``uneven``, if there are several.
        """
        fraction, amplitude, *decays = self.of(stated)[:N_SHARED].tolist()
        factors = self.of(stated)[N_SHARED:] if wider else np.zeros(len(self.counts))
        least, most = np.log((LEAST, MOST))
        highest = [one if wider and stated.amplitude else MOST_DECAY for one in decays]
        free = uneven & (self.counts > 0) & (np.count_nonzero(self.counts) > 1)
        low = [*((fraction, amplitude) if wider else (least, least)), 0.0, 0.0]
        return np.array(
            [
                [*low, *np.where(free & (not wider), least, factors)],
                [most, most, *highest, *np.where(free, most, factors)],
            ]
        )

    def price(self, numbers: FloatArray) -> float:
        """Return what the numbers cost, in nats: half of ln(n) each for n coefficients that tell it (Schwarz 1978)."""
        shared, uneven = N_SHARED * np.log(self.counts.sum()), (numbers[N_SHARED:] != 0) & (self.counts > 0)
        return float(0.5 * (shared + np.sum(np.log(self.counts[uneven]))))

    def told_before(self, numbers: FloatArray) -> Told:
        """Return what is known of the numbers beforehand, ln of which is zero at the likeliest ones."""
        scales = np.array([SPREAD, SPREAD, DECAY, DECAY, *np.full(len(self.counts), UNEVEN)])
        away = (numbers - self.of(TYPICAL)) / scales
        if not self.widths(numbers).amplitude:
            away[1:N_SHARED] = 0.0
        return Told(-0.5 * float(away @ away), -away / scales, np.diag(scales**-2))

    def rounded(self, numbers: FloatArray, least: PriorWidths | None) -> PriorWidths:
        """Return widths of three digits and decays to a thousandth, the same however sums over ranks are rounded.

        That says all that data do. None of the widths gets less than in ``least`` by it.
        """
        widths = self.widths(numbers)
        fraction, amplitude = _rounded(widths.fraction), _rounded(widths.amplitude)
        azimuthal = np.array([_rounded(one) for one in widths.azimuthal])
        if least is not None:
            fraction, amplitude = max(fraction, least.fraction), max(amplitude, least.amplitude)
            azimuthal = np.maximum(azimuthal, np.exp(self.of(least)[N_SHARED:])) if len(azimuthal) else azimuthal
        return replace(
            widths,
            fraction=fraction,
            amplitude=amplitude,
            decay=(round(widths.decay[0], 3), round(widths.decay[1], 3)),
            azimuthal=tuple(azimuthal.tolist()),
        )


def _rounded(number: float) -> float:
    return float(f"{number:.3g}")
