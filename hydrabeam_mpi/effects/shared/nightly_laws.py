"""Laws of what changes during the night, in data of several nights: alike in each by sidereal time, or anew in each.

What follows the sky, or the same weather at the same hour, is one function of sidereal time, which other nights have
too. What does not is a function of its own each night, and says nothing of another. Of either kind, and of one law over
all nights, the data decide, at the price of their numbers. A night is a sidereal day, and begins in the middle of the
longest sidereal time of which there are no data.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field

from hydrabeam_mpi.data.observation import SIDEREAL_DAY, FloatArray, IntArray
from hydrabeam_mpi.effects.shared.time_laws import SECOND, Jd, Smooth, highest_order

Night = Annotated[int, Field(ge=0, le=99_999)]


@dataclass(frozen=True)
class Sidereal(Smooth):
    """Polynomials in sidereal time, the same each night.

    Attributes
    ----------
    hours : (float, float), optional
        First and last sidereal time, as JD of the first night.
    """

    hours: tuple[Jd, Jd] | None = None
    name = "sidereal"

    def over(self, times: FloatArray) -> Self:
        """Return the law with its span and hours, those of ``times``, JD, where it has none of its own."""
        law = super().over(times)
        return law if law.hours is not None else replace(law, hours=_hours(times))

    def candidates(self, fitted: FloatArray, times: FloatArray) -> Self:
        """Return the law with as many orders as half of the fitted times of a night determine."""
        nights, since = self._since(fitted)
        most = int(np.unique(nights, return_counts=True)[1].max())
        return replace(self, orders=tuple(range(1, highest_order(np.sort(since), most) + 1)))

    def not_applicable(self, fitted: FloatArray, times: FloatArray) -> str | None:
        """Ask for several nights, of which only one need be fitted."""
        n_nights = len(np.unique(self.over(times).nights_of(times)))
        return None if n_nights > 1 else "what is alike each night needs two nights or more; there is one"

    def covers(self, times: FloatArray) -> bool:
        """Whether most of these ``times``, JD, are of sidereal times that it is known of; it stays as it is beyond."""
        if self.hours is None:
            return False
        first, last = self.hours
        since = self._since(times)[1]
        return bool(np.median(abs(since - (last - first) / 2)) < (last - first) / 2 + SECOND)

    def nights_of(self, times: FloatArray) -> IntArray:
        """Return the number of each time's night, (Ntimes,), from the first one of this law's; ``times`` are JD."""
        return self._since(times)[0]

    def anew(self, times: FloatArray) -> tuple[Self, list[list[int]]]:
        """Return the law with the hours of other data."""
        law, alike = super().anew(times)
        return replace(law, span=None, hours=None).over(times), alike

    def functions(self, times: FloatArray) -> FloatArray:
        """Return the polynomials, constant beyond the hours."""
        assert self.hours is not None
        return Smooth(self.hours, self.orders).functions(self.hours[0] + self._since(times)[1])

    def describe(self) -> dict[str, Any]:
        """Return name, span, orders and hours."""
        return super().describe() | ({} if self.hours is None else {"hours": list(self.hours)})

    def _since(self, times: FloatArray) -> tuple[IntArray, FloatArray]:
        """Return the night of each time, and the days since the first hour, from the middle of the gap before it."""
        assert self.hours is not None
        first, last = self.hours
        margin = (SIDEREAL_DAY - (last - first)) / 2
        turns = np.floor((times - first + margin) / SIDEREAL_DAY)
        return turns.astype(int), times - first - turns * SIDEREAL_DAY


@dataclass(frozen=True)
class Nightly(Sidereal):
    """The same polynomials, of each night its own, and by how much a night is above the first.

    Attributes
    ----------
    nights : tuple of int
        Of each of the ``orders``, from 0 for the first; levels are those above the first night.
    """

    nights: tuple[Night, ...] = ()
    name = "nightly"

    def candidates(self, fitted: FloatArray, times: FloatArray) -> Self:
        """Return the law with as many orders as half of the fitted times of a night determine, the slowest first."""
        nights, of_night = np.unique(self.nights_of(fitted), return_inverse=True)
        highest = [highest_order(fitted[of_night == n], int(np.sum(of_night == n))) for n in range(len(nights))]
        slowest = [int(n == 0) for n in range(len(nights))]
        orders = range(max(highest) + 1)
        return self._of(
            [(k, int(nights[n])) for k in orders for n in range(len(nights)) if slowest[n] <= k <= highest[n]]
        )

    def not_applicable(self, fitted: FloatArray, times: FloatArray) -> str | None:
        """Ask for several nights that are fitted."""
        n_nights = len(np.unique(self.over(times).nights_of(fitted)))
        return None if n_nights > 1 else "what begins anew each night needs two fitted nights or more; there is one"

    def covers(self, times: FloatArray) -> bool:
        """Whether these ``times``, JD, are of the nights between the first and the last that it is known of."""
        return Smooth(self.span).covers(times)

    def at(self, chosen: IntArray | Sequence[int]) -> Self:
        """Return the law with some orders of some nights."""
        return self._of([(self.orders[i], self.nights[i]) for i in sorted(set(chosen))])

    def with_level(self) -> Self:
        """Return the law with the first night's level, too: those of the others are then their own."""
        first = min(self.nights, default=0)
        if (0, first) in zip(self.orders, self.nights, strict=True):
            return self
        return replace(self, orders=(0, *self.orders), nights=(first, *self.nights))

    def first(self, n: int) -> Self:
        """Return the law with so many functions of each night."""
        return self.at(range(len(self.orders))[: n * len(set(self.nights))])

    def names(self) -> list[str]:
        """Return the nights, and what changes in them."""
        return [f"night {1 + night}: {what}" for night, what in zip(self.nights, super().names(), strict=True)]

    def anew(self, times: FloatArray) -> tuple[Self, list[list[int]]]:
        """Return the law in other data, of which each night's numbers are as large as those of all nights here."""
        law = replace(self, span=None, hours=None).over(times)
        nights = np.unique(law.nights_of(times)).tolist()
        law = law._of([(order, night) for order in sorted(set(self.orders)) for night in nights])
        return law, [[i for i, other in enumerate(self.orders) if other == order] for order in law.orders]

    def functions(self, times: FloatArray) -> FloatArray:
        """Return the polynomials, zero in all nights but their own."""
        of_nights = self.nights_of(times)[:, np.newaxis] == np.array(self.nights, dtype=int)
        return np.where(of_nights, super().functions(times), 0.0)

    def describe(self) -> dict[str, Any]:
        """Return name, span, hours, orders and nights."""
        return {**super().describe(), "nights": list(self.nights)}

    def _of(self, chosen: Sequence[tuple[int, int]]) -> Self:
        return replace(self, orders=tuple(one for one, _ in chosen), nights=tuple(one for _, one in chosen))


def _hours(times: FloatArray) -> tuple[float, float]:
    """Return the first and the last sidereal time of some times, JD, as that of the first night."""
    phase = np.sort((times - times.min()) % SIDEREAL_DAY)
    after = int(np.argmax(np.diff(phase, append=phase[0] + SIDEREAL_DAY)))
    first, last = float(phase[(after + 1) % len(phase)]), float(phase[after])
    first -= SIDEREAL_DAY * (first > last)
    return float(times.min()) + first, float(times.min()) + last
