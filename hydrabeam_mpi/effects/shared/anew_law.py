"""What has a value of its own at each integration, which says nothing of the next: scintillation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np

from hydrabeam_mpi.data.observation import FloatArray, IntArray
from hydrabeam_mpi.effects.shared.time_laws import SECOND, Jd, TimeLaw

MOST_TIMES = 600
"""Integrations at most, of each of which there is a number. That is about time alone: products of so many columns take
as long as those of all other effects together."""


@dataclass(frozen=True)
class Anew(TimeLaw):
    """A number for each integration, one there and zero at all others.

    What tells it from another law is how large it all is: the prior's width, which all times have in common.

    Attributes
    ----------
    times : tuple of float
        JD, of the integrations.
    """

    times: tuple[Jd, ...] = ()
    name = "anew"
    is_of_single_times: ClassVar[bool] = True

    def candidates(self, fitted: FloatArray, times: FloatArray) -> Self:
        """Return the law with all times."""
        return replace(self, times=tuple(times.tolist()))

    def at(self, chosen: IntArray | Sequence[int]) -> Self:
        """Return the law with some times."""
        return replace(self, times=tuple(self.times[i] for i in sorted(set(chosen))))

    def first(self, n: int) -> Self:
        """Return the law as it is: without all times it is none."""
        return self

    def best(self, ordered: IntArray, most: int) -> IntArray:
        """Return the first ones."""
        return ordered[:most]

    def not_applicable(self, fitted: FloatArray, times: FloatArray) -> str | None:
        """Ask for no more times than can be weighed."""
        if len(times) > MOST_TIMES:
            return f"it has a parameter for each of {len(times)} integrations; {MOST_TIMES} at most are looked at"
        return None

    def names(self) -> list[str]:
        """Return the times."""
        return [f"at JD {jd:.5f}" for jd in self.times]

    def functions(self, times: FloatArray) -> FloatArray:
        """Return one where a time is that of the number, else zero."""
        apart = np.abs(times[:, np.newaxis] - np.array(self.times).reshape(-1))
        return np.where(apart < 0.5 * SECOND, 1.0, 0.0)

    def followed_by(self, law: TimeLaw, fitted: FloatArray, values: FloatArray, std: FloatArray) -> FloatArray:
        """Return the numbers of another law, (n,), that come nearest to these at the ``fitted`` times, JD.

        Values and errors are (Ntimes,); errors are zero where there is no value.
        """
        known = self.functions(fitted).any(axis=0) & (std > 0)
        return law.numbers(np.array(self.times)[known], values[known], std[known])

    def describe(self) -> dict[str, Any]:
        """Return name, span and times."""
        return {**super().describe(), "times": list(self.times)}
