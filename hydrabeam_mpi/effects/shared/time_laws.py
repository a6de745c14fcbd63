"""Laws by which something may change in time: functions phi_k of the time, one for each number that describes it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from numpy.polynomial.legendre import Legendre
from pydantic import Field

from hydrabeam_mpi.data.observation import FloatArray, IntArray

MOST_ORDERS = 16
"""Orders of polynomials that are looked at: eight swings in a night. The data's own limit is half of the fitted times;
this one is for time alone: of twenty antennas no more functions can be weighed together anyway."""
LEVEL = "level"
"""What the number of the function that is one at all times is called."""
AROUND_JUMP = (2, 4, 8)
"""Fitted times before and after a jump that are compared: what lasts as long shows most so."""
SECOND = 1 / 86400
"""Days by which times may be off, as files round them."""

Order = Annotated[int, Field(ge=0, le=99)]
Jd = Annotated[float, Field(ge=0, le=1e8)]


@dataclass(frozen=True)
class TimeLaw(ABC):
    """Functions of the time between the first and the last time of some data; none for a law yet to be found.

    Attributes
    ----------
    span : (float, float), optional
        First and last time, JD. Without it they are those of the data at hand.
    """

    span: tuple[Jd, Jd] | None = None

    name: ClassVar[str]
    sought: ClassVar[bool] = True
    """Whether it is looked for in data; else it is there for those who name it."""
    is_of_single_times: ClassVar[bool] = False
    """Whether each of its functions is zero at all times but one."""

    @abstractmethod
    def candidates(self, fitted: FloatArray, times: FloatArray) -> Self:
        """Return the law with all functions that the ``fitted`` ones of some ``times``, JD ascending, can tell."""

    @abstractmethod
    def at(self, chosen: IntArray | Sequence[int]) -> Self:
        """Return the law with some of its functions, in their order."""

    @abstractmethod
    def names(self) -> list[str]:
        """Return what the number of each function is called."""

    @abstractmethod
    def functions(self, times: FloatArray) -> FloatArray:
        """Return the functions at ``times``, JD, (Ntimes, n); the span must be known."""

    @abstractmethod
    def best(self, ordered: IntArray, most: int) -> IntArray:
        """Return at most so many of the functions, the best ones first, that are not nearly the same."""

    def scanned(self, fitted: FloatArray, times: FloatArray) -> tuple[FloatArray, IntArray]:
        """Return what tells which functions are the best, at ``times``, (Ntimes, n), and of which one each is, (n,).

        It is the functions themselves, or also what else shows them.
        """
        functions = self.functions(times)
        return functions, np.arange(functions.shape[1])

    def alternatives(self, number: int, fitted: FloatArray, times: FloatArray) -> list[Self]:
        """Return the law with one of its functions other than it is at those of the ``times`` that are not fitted."""
        return []

    def not_applicable(self, fitted: FloatArray, times: FloatArray) -> str | None:
        """Say why the ``fitted`` ones of some ``times``, JD ascending, cannot show it; None where they can."""
        return None

    def first(self, n: int) -> Self:
        """Return the law with so many of its functions, or of each night, where these have their own."""
        return self.at(range(len(self.names()))[:n])

    def numbers(self, times: FloatArray, values: FloatArray, std: FloatArray) -> FloatArray:
        """Return the numbers, (n,), that come nearest to values with these errors; all are (Ntimes,)."""
        return np.asarray(np.linalg.lstsq(self.functions(times) / std[:, np.newaxis], values / std, rcond=None)[0])

    def anew(self, times: FloatArray) -> tuple[Self, list[list[int]]] | None:
        """Return the law over other ``times``, JD, where only the sizes of its numbers are known.

        With it come, for each of its functions, those of this law whose numbers are of this size.
        """
        return None

    def over(self, times: FloatArray) -> Self:
        """Return the law with its span, that of ``times`` where it has none of its own."""
        return self if self.span is not None else replace(self, span=(float(times.min()), float(times.max())))

    def covers(self, times: FloatArray) -> bool:
        """Whether it is known at all of these ``times``, JD."""
        if self.span is None:
            return False
        return bool(times.min() > self.span[0] - SECOND and times.max() < self.span[1] + SECOND)

    def describe(self) -> dict[str, Any]:
        """Return name and span."""
        return {"law": self.name} | ({} if self.span is None else {"span": list(self.span)})


@dataclass(frozen=True)
class Smooth(TimeLaw):
    """Legendre polynomials over the span, each of range one: its number is the change between the extremes.

    Attributes
    ----------
    orders : tuple of int
        Order zero is the level, which is not looked for, as it is what is constant.
    """

    orders: tuple[Order, ...] = ()
    name = "smooth"

    def candidates(self, fitted: FloatArray, times: FloatArray) -> Self:
        """Return the law with as many orders as half of the fitted times determine."""
        return replace(self, orders=tuple(range(1, highest_order(fitted, len(fitted)) + 1)))

    def at(self, chosen: IntArray | Sequence[int]) -> Self:
        """Return the law with some orders."""
        return replace(self, orders=tuple(self.orders[i] for i in sorted(set(chosen))))

    def with_level(self) -> Self:
        """Return the law with its level first, for what is not looked for without it."""
        return self if 0 in self.orders else replace(self, orders=(0, *self.orders))

    def best(self, ordered: IntArray, most: int) -> IntArray:
        """Return the first ones, as polynomials are nearly orthogonal."""
        return ordered[:most]

    def anew(self, times: FloatArray) -> tuple[Self, list[list[int]]]:
        """Return the law with the span of other times, at another level, which is to drift as far."""
        alike = [[*range(len(self.orders))], *([number] for number in range(len(self.orders)))]
        return replace(self, span=None, orders=(0, *self.orders)).over(times), alike

    def names(self) -> list[str]:
        """Return what the change is."""
        known = {0: LEVEL, 1: "drift from first to last time", 2: "curvature, ends less middle"}
        return [known.get(order, f"wave of Legendre order {order}, peak to peak") for order in self.orders]

    def functions(self, times: FloatArray) -> FloatArray:
        """Return the polynomials, constant beyond the span."""
        assert self.span is not None
        first, last = self.span
        place = np.clip(2 * (times - first) / max(last - first, SECOND) - 1, -1, 1)
        known = [_of_range_one(order)(place) if order else np.ones(len(times)) for order in self.orders]
        return np.stack(known, axis=-1) if known else np.zeros((len(times), 0))

    def describe(self) -> dict[str, Any]:
        """Return name, span and orders."""
        return {**super().describe(), "orders": list(self.orders)}


@dataclass(frozen=True)
class Piecewise(TimeLaw):
    """Constant but for jumps: steps, each of them zero before and one from its time on.

    Attributes
    ----------
    jumps : tuple of float
        JD, between two times of the data.
    """

    jumps: tuple[Jd, ...] = ()
    name = "piecewise"

    def candidates(self, fitted: FloatArray, times: FloatArray) -> Piecewise:
        """Return the law with a jump before each of the fitted times of which two are before and two after it.

        What is so at the first time alone, or at the last, is that time's own fault and no level.
        """
        middles = 0.5 * (times[1:] + times[:-1])
        return replace(self, jumps=tuple(middles[np.searchsorted(times, fitted[2:-1]) - 1].tolist()))

    def at(self, chosen: IntArray | Sequence[int]) -> Piecewise:
        """Return the law with some jumps."""
        return replace(self, jumps=tuple(self.jumps[i] for i in sorted(set(chosen))))

    def scanned(self, fitted: FloatArray, times: FloatArray) -> tuple[FloatArray, IntArray]:
        """Return the steps, and by what a few fitted times after each jump differ from as many before it.

        What comes and goes again a step shows where it comes, but hardly where it goes: from there on all is as it was.
        """
        edge = np.searchsorted(fitted, np.array(self.jumps).reshape(-1))
        is_fitted, from_jump = (
            np.isin(times, fitted)[:, np.newaxis],
            np.searchsorted(fitted, times)[:, np.newaxis] - edge,
        )
        found = [self.functions(times)]
        for n in AROUND_JUMP:
            # Of as many on either side: of a few at an end of the data each would count for more.
            is_whole = (edge >= n) & (edge <= len(fitted) - n)
            is_near = is_fitted & is_whole & (from_jump >= -n) & (from_jump < n)
            found.append(np.where(is_near, np.where(from_jump >= 0, 1.0, -1.0), 0.0))
        return np.concatenate(found, axis=1), np.tile(np.arange(len(self.jumps)), len(found))

    def best(self, ordered: IntArray, most: int) -> IntArray:
        """Return the first ones and none next to them, which explain nearly as much."""
        kept: list[int] = []
        for one in ordered.tolist():
            if len(kept) < most and all(abs(one - other) > 1 for other in kept):
                kept.append(one)
        return np.array(kept, dtype=int)

    def alternatives(self, number: int, fitted: FloatArray, times: FloatArray) -> list[Piecewise]:
        """Return the law with a jump before any other of the times between the same two that are fitted."""
        jump, others = self.jumps[number], tuple(np.delete(self.jumps, number).tolist())
        place = int(np.clip(np.searchsorted(fitted, jump), 1, len(fitted) - 1))
        between = times[(times >= fitted[place - 1]) & (times <= fitted[place])]
        moved = [other for other in (0.5 * (between[1:] + between[:-1])).tolist() if other != jump]
        return [replace(self, jumps=tuple(sorted((*others, other)))) for other in moved]

    def with_level(self) -> Piecewise:
        """Return the law with a jump before the first time, for what is not looked for without its level."""
        assert self.span is not None
        return replace(self, jumps=(self.span[0] - SECOND, *self.jumps))

    def wanted_by(self, times: FloatArray, values: FloatArray, std: FloatArray) -> list[int]:
        """Return the numbers of the jumps that values with these errors want; all are (Ntimes,).

        A jump is worth it that lowers N ln(what is left of N values) by more than ln N (Schwarz 1978) and the price of
        picking one of all. About a level, the first of them, those are added that leave least, and what is not worth it
        beside the others, as the level may not be, is left out in the end.
        """
        steps, values = self.functions(times) / std[:, np.newaxis], values / std
        n = len(times)
        if n < 2 or len(self.jumps) < 2:
            return []
        price = float(np.log(n) + 2 * np.log(len(self.jumps)))

        def left(which: list[int]) -> float:
            rest = values - steps[:, which] @ np.linalg.lstsq(steps[:, which], values, rcond=None)[0]
            # Errors alone leave one of each.
            return n * float(np.log(max(float(rest @ rest), n)))

        chosen = [0]
        while 2 * len(chosen) < n:
            best = min(range(1, len(self.jumps)), key=lambda one: left([*chosen, one]))
            if left([*chosen, best]) + price >= left(chosen):
                break
            chosen.append(best)
        for one in chosen.copy():
            others = [other for other in chosen if other != one]
            chosen = others if left(others) < left(chosen) + price else chosen
        return chosen

    def anew(self, times: FloatArray) -> tuple[Self, list[list[int]]]:
        """Return the law with one level of other times, that differs by as much as the jumps do."""
        law = replace(self, span=None, jumps=(float(times.min()) - SECOND,)).over(times)
        return law, [[*range(len(self.jumps))]]

    def names(self) -> list[str]:
        """Return when it jumps."""
        return [f"jump at JD {jump:.5f}" for jump in self.jumps]

    def functions(self, times: FloatArray) -> FloatArray:
        """Return the steps."""
        return (times[:, np.newaxis] >= np.array(self.jumps).reshape(-1)).astype(float)

    def describe(self) -> dict[str, Any]:
        """Return name, span and jumps."""
        return {**super().describe(), "jumps": list(self.jumps)}


def highest_order(fitted: FloatArray, n: int) -> int:
    """Return the order that half of ``n`` times tell, with no swing shorter than the longest of which there are none.

    The fitted times, (Ntimes,), are ascending; of some that are alike only ``n`` may count.
    """
    gap = float(np.diff(fitted).max(initial=0.0))
    return min(MOST_ORDERS, n // 2, int(np.ptp(fitted) / gap) if gap > 0 else 0)


@lru_cache
def _of_range_one(order: int) -> Legendre:
    """Return a Legendre polynomial over its range on [-1, 1]."""
    polynomial = Legendre.basis(order)
    extremes = polynomial(np.concatenate([[-1.0, 1.0], polynomial.deriv().roots().real]))
    return polynomial / float(np.ptp(extremes))
