"""What an answer consists of."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tests.validation.undeclared.setting import Plan
from tests.validation.undeclared.truth import Truth


@dataclass(frozen=True)
class Parameter:
    """A number that the loop should find.

    Attributes
    ----------
    thing : str
        What it belongs to, such as "antenna 23", "baseline 3-17", "source", "array".
    quantity : str
        Such as "delay".
    unit : str
    value : float
    """

    thing: str
    quantity: str
    unit: str
    value: float


@dataclass(frozen=True)
class Where:
    """What carries an effect; None where it is everywhere.

    Attributes
    ----------
    antennas : list of int, optional
        Numbers.
    antpairs : list of (int, int), optional
        Numbers.
    times : list of int, optional
        Indices.
    freqs : list of float, optional
        Hz.
    """

    antennas: list[int] | None = None
    antpairs: list[list[int]] | None = None
    times: list[int] | None = None
    freqs: list[float] | None = None


@dataclass(frozen=True)
class Drawn:
    """What an effect turned out to be.

    Attributes
    ----------
    parameters : list of Parameter
        What the loop should find.
    where : Where
    n_params : int
        How many numbers it takes.
    about : dict
        What else there is to know of it.
    """

    parameters: list[Parameter] = field(default_factory=list)
    where: Where = field(default_factory=Where)
    n_params: int = 1
    about: dict[str, float] = field(default_factory=dict)


Apply = Callable[[Truth, np.random.Generator, float], Drawn]


@dataclass(frozen=True)
class Kind:
    """Something that may be wrong.

    Attributes
    ----------
    name : str
        Of the case.
    apply : callable
        (truth, rng, strength) -> Drawn; changes the truth.
    weakest, strongest : float
        Range of strengths, log-uniform.
    unit : str
        Of the strength.
    plan : Plan
        What it needs of the setting.
    effect : str
        As in the loop's records, for effects that it knows; where it is not the name.
    law : str
        How it goes on in time, as in the loop's records.
    """

    name: str
    apply: Apply
    weakest: float
    strongest: float
    unit: str
    plan: Plan = field(default_factory=Plan)
    effect: str = ""
    law: str = "constant"

    @property
    def is_called(self) -> str:
        """What the loop should say."""
        return self.effect or self.name


def some_antennas(truth: Truth, rng: np.random.Generator, counts: Sequence[int] | None = None) -> list[int]:
    """Draw indices of antennas: one, three or all of them, or as many as one of ``counts``."""
    n = truth.setting.n_ants
    count = int(rng.choice(counts if counts is not None else [1, 3, n]))
    return sorted(rng.choice(n, count, replace=False).tolist())


def antenna(truth: Truth, index: int) -> str:
    """Name an antenna."""
    return f"antenna {truth.setting.numbers[index]}"


def baseline(truth: Truth, index: int) -> str:
    """Name a baseline as the file has it."""
    one, two = truth.setting.numbers[truth.setting.antpairs[index]].tolist()
    return f"baseline {one}-{two}"


def numbers(truth: Truth, antennas: Sequence[int]) -> list[int]:
    """Return antenna numbers."""
    return [int(truth.setting.numbers[index]) for index in antennas]


def pairs(truth: Truth, baselines: Sequence[int]) -> list[list[int]]:
    """Return pairs of antenna numbers."""
    chosen: list[Any] = truth.setting.numbers[truth.setting.antpairs[list(baselines)]].tolist()
    return chosen
