"""A Gaussian process in time as a law: functions of which numbers of equal widths make up a prior covariance K(t - t').

They are the modes of K between the first and the last time, phi_k(t) = int K(t - t') u_k(t') dt' / sqrt(lambda_k), with
sum_k phi_k(t) phi_k(t') = K(t - t') and K(0) = 1 (Rasmussen and Williams 2006, section 4.3). Where K has equal power at
all rates up to a highest one, these are the prolate spheroidal functions, discrete ones on a grid: DPSS (Slepian 1978).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field

from hydrabeam_mpi.data.observation import FloatArray, IntArray
from hydrabeam_mpi.effects.shared.time_laws import SECOND, TimeLaw
from hydrabeam_mpi.inference.over_frequency import KERNELS, modes_of, within_delay

DPSS = "dpss"
COVARIANCES = {DPSS: lambda times, minutes: within_delay(times, 1 / minutes), **KERNELS}
"""Of times in minutes; those over frequency, which do not know what they are of."""
LEFT_OUT = 1e-3
"""Part of the variance that modes may leave out: errors of 3% of the prior's width, that no data tell beforehand."""
FINE = 8
"""Points of the grid within what the covariance calls a time: modes are kept that change no faster."""

Minutes = Annotated[float, Field(gt=0.01, le=1e5)]
Number = Annotated[int, Field(ge=0, le=9999)]


@dataclass(frozen=True)
class Correlated(TimeLaw):
    """Modes of a covariance in time, each for a number; all that matter where none are named.

    Attributes
    ----------
    kernel : str
        "dpss", of which ``minutes`` are the shortest period, or one with ``minutes`` as the length.
    minutes : float
    modes : tuple of int
        From 0 for that with the largest variance.
    """

    kernel: Literal["dpss", "squared-exponential", "matern-3/2", "matern-5/2"] = "squared-exponential"
    minutes: Minutes = 60.0
    modes: tuple[Number, ...] = ()
    name = "correlated"
    sought: ClassVar[bool] = False

    def over(self, times: FloatArray) -> Self:
        """Return the law with its span, and with its modes over that."""
        law = super().over(times)
        return law if law.modes else replace(law, modes=tuple(range(law._on_grid()[1].shape[1])))

    def candidates(self, fitted: FloatArray, times: FloatArray) -> Self:
        """Return the law with all modes."""
        return replace(self, modes=()).over(times)

    def at(self, chosen: IntArray | Sequence[int]) -> Self:
        """Return the law with some modes."""
        return replace(self, modes=tuple(self.modes[i] for i in sorted(set(chosen))))

    def best(self, ordered: IntArray, most: int) -> IntArray:
        """Return the first ones, as modes are orthogonal."""
        return ordered[:most]

    def names(self) -> list[str]:
        """Return the modes' numbers."""
        return [f"mode {mode}" for mode in self.modes]

    def functions(self, times: FloatArray) -> FloatArray:
        """Return the modes at times, (Ntimes, n), as at its ends beyond the span."""
        grid, modes = self._on_grid()
        assert self.span is not None
        place = (np.clip(times, *self.span) - self.span[0]) / SECOND / 60
        between = COVARIANCES[self.kernel](np.concatenate([place, grid]), self.minutes)[: len(place), len(place) :]
        chosen = modes[:, list(self.modes)]
        return np.asarray(between @ (chosen / np.sum(chosen**2, axis=0)))

    def describe(self) -> dict[str, Any]:
        """Return name, span, kernel, minutes and modes."""
        return {**super().describe(), "kernel": self.kernel, "minutes": self.minutes, "modes": list(self.modes)}

    def _on_grid(self) -> tuple[FloatArray, FloatArray]:
        assert self.span is not None
        return _modes(self.kernel, self.minutes, (self.span[1] - self.span[0]) / SECOND / 60)


@lru_cache(maxsize=8)
def _modes(kernel: str, minutes: float, length: float) -> tuple[FloatArray, FloatArray]:
    """Return times, minutes, (N,), and the modes over them, (N, n), of which the squares sum to ``N`` times lambda."""
    grid = np.linspace(0, length, FINE * (1 + int(np.ceil(length / minutes))))
    modes = modes_of(COVARIANCES[kernel](grid, minutes))
    lacking = 1 - np.cumsum(np.mean(modes**2, axis=0))
    return grid, modes[:, : 1 + int(np.count_nonzero(lacking > LEFT_OUT))]
